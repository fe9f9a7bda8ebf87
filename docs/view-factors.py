"""Radiation between the surfaces of a closed room: two zones at given temperatures, the rest adiabatic.

  luxel factors room.obj --enclosed
  python view-factors.py room.factors.npz 0..132=30 132..264=18 --emissivity 0.9

Rows 0..132 are held at 30 °C, rows 132..264 at 18 °C; all others let no heat through.
"""
import argparse

import numpy as np
from scipy.sparse import diags, identity, load_npz
from scipy.sparse.linalg import spsolve

SIGMA = 5.670374419e-8  # W/(m² K⁴)

arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
arguments.add_argument("factors", help="FILE.factors.npz")
arguments.add_argument("zones", nargs="+", help="rows and their temperature: 0..132=30 (°C)")
arguments.add_argument("--emissivity", type=float, default=0.9)
asked = arguments.parse_args()

F, areas = load_npz(asked.factors), np.load(asked.factors)["areas"]
black, held = np.zeros(len(areas)), np.zeros(len(areas), bool)  # sigma T⁴ where T is held
names = np.full(len(areas), "adiabatic rest", dtype="<U40")
for zone in asked.zones:
    rows, celsius = zone.split("=")
    first, last = map(int, rows.split(".."))
    held[first:last], names[first:last] = True, f"{rows} at {celsius} °C"
    black[first:last] = SIGMA * (float(celsius) + 273.15) ** 4

# Radiosity J = e sigma T⁴ + (1 - e) F J where T is held; J = F J where no heat passes.
e = np.where(held, asked.emissivity, 0.0)
J = spsolve((identity(len(areas)) - diags(1.0 - e) @ F).tocsc(), e * black)
heat = areas * (J - F @ J)  # W that each row gives off, net

for name in dict.fromkeys(names):
    rows = names == name
    print(f"{name:>22}  {areas[rows].sum():8.3f} m²  {heat[rows].sum():+12.6f} W")
print(f"{'sum':>22}  {areas.sum():8.3f} m²  {heat.sum():+12.6f} W")
warm = (J[~held] / SIGMA) ** 0.25 - 273.15  # an adiabatic surface is as warm as what it sees
print(f"adiabatic rest: {warm.min():.2f} to {warm.max():.2f} °C")
