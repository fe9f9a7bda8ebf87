"""Radiation between very many surfaces: products with a matrix of `luxel factors --compressed`.

  luxel factors room.obj --compressed
  python view-factors-compressed.py room.factors.npz 0..132=30 132..264=18 --emissivity 0.9

Rows 0..132 are held at 30 °C, rows 132..264 at 18 °C; all others let no heat through. The radiosity
is found by conjugate gradients, which take a product a step and never a row. Needs numpy and scipy.
"""
import argparse

import numpy as np
from scipy.sparse import csc_array
from scipy.sparse.linalg import LinearOperator, cg

SIGMA = 5.670374419e-8  # W/(m² K⁴)
SIDE, RUN = 8, 1 << 16  # parts along a tile; tiles unpacked at a time


class Compressed:
    """G[i, j] = A_i F[i, j], symmetric, in m². `apply(x)` is G @ x."""

    def __init__(self, name):
        with np.load(name) as file:
            if file["format"] != b"luxel-compressed-1":
                raise SystemExit(f"{name}: expected luxel-compressed-1, found {file['format']}")
            self.areas, self.part_row = file["areas"], file["part_row"]
            self.u, self.v = (self.low_rank(file, name, k) for k, name in enumerate("uv"))
            self.tile_row, self.tile_column = file["tile_row"], file["tile_column"]
            self.bits, self.entries = file["tile_bits"], file["entries"]

    def low_rank(self, file, name, side):
        """All U, or all V: a column for each rank of each block, over the parts."""
        rank = file["block_rank"]
        first = np.repeat(file["block_first"][:, side].astype(np.int64), rank)
        count = np.repeat(file["block_count"][:, side].astype(np.int64), rank)
        ends = np.concatenate([[0], np.cumsum(count)])
        kind = np.int32 if ends[-1] < 2**31 else np.int64
        rows = np.arange(ends[-1], dtype=kind)
        rows -= np.repeat((ends[:-1] - first).astype(kind), count)
        shape = len(self.part_row), len(count)
        return csc_array((file[name], rows, ends.astype(kind)), shape=shape)

    def apply(self, x):
        """What leaves the rows, per m², to what arrives at them, W."""
        parts = x[self.part_row]
        y = self.u @ (self.v.T @ parts) + self.v @ (self.u.T @ parts)
        # Parts in eights, filled up; each tile serves both directions.
        eights = np.pad(parts, (0, -len(parts) % SIDE)).reshape(-1, SIDE)
        out, start = np.zeros_like(eights), 0
        for a in range(0, len(self.bits), RUN):
            run = slice(a, a + RUN)
            there = np.unpackbits(self.bits[run].view(np.uint8), bitorder="little").view(bool)
            tiles = np.zeros(len(there))
            end = start + np.count_nonzero(there)
            tiles[there], start = self.entries[start:end], end
            tiles = tiles.reshape(-1, SIDE, SIDE)
            row, column = self.tile_row[run], self.tile_column[run]
            np.add.at(out, row, np.einsum("tij,tj->ti", tiles, eights[column]))
            np.add.at(out, column, np.einsum("tij,ti->tj", tiles, eights[row]))
        y += out.reshape(-1)[: len(y)]
        return np.bincount(self.part_row, y, len(x))


if __name__ == "__main__":
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("factors", help="FILE.npz of luxel factors --compressed")
    arguments.add_argument("zones", nargs="*", help="rows and their temperature: 0..132=30 (°C)")
    arguments.add_argument("--emissivity", type=float, default=0.9)
    arguments.add_argument("--enclosed", action="store_true", help="nothing leaves a closed room")
    asked = arguments.parse_args()

    G = Compressed(asked.factors)
    areas, there = G.areas, G.areas > 0
    if not there.any():
        raise SystemExit(f"{asked.factors}: expected rows with an area, found none")
    sent = G.apply(np.ones(len(areas)))
    sums = sent[there] / areas[there]
    gaps = abs(1 - sums)
    print(f"closure: |1 - sum of a row| {gaps.mean():.1e} in the mean, {gaps.max():.1e} at most")

    black, held = np.zeros(len(areas)), np.zeros(len(areas), bool)  # sigma T⁴ where T is held
    names = np.full(len(areas), "adiabatic rest", dtype="<U40")
    for zone in asked.zones:
        rows, celsius = zone.split("=")
        first, last = map(int, rows.split(".."))
        held[first:last], names[first:last] = True, f"{rows} at {celsius} °C"
        black[first:last] = SIGMA * (float(celsius) + 273.15) ** 4

    # What a row gives off, net: A J - G J = k (sigma T⁴ - J), k = A e / (1 - e) where T is held and
    # 0 elsewhere. So (A + k - G) J = k sigma T⁴, symmetric and positive. In a closed room rows sum
    # to A but for errors; with the sum in place of A no heat is lost, whatever they are.
    out = sent if asked.enclosed else areas
    k = np.where(held, areas * asked.emissivity / (1 - asked.emissivity), 0.0)
    if asked.zones:
        n, diagonal = len(areas), np.where(there, out + k, 1.0)
        matrix = LinearOperator((n, n), lambda J: diagonal * J - G.apply(J), dtype=float)
        scaled = LinearOperator((n, n), lambda r: r / diagonal, dtype=float)
        J, left = cg(matrix, k * black, rtol=1e-10, maxiter=1000, M=scaled)
        if left:
            raise SystemExit("the radiosity did not converge: is the scene open, or nothing held?")
        heat = out * J - G.apply(J)  # W that each row gives off, net
        for name in dict.fromkeys(names):
            rows = names == name
            print(f"{name:>22}  {areas[rows].sum():8.3f} m²  {heat[rows].sum():+12.6f} W")
        print(f"{'sum':>22}  {areas.sum():8.3f} m²  {heat.sum():+12.6f} W")
        rest = there & ~held
        if rest.any():  # an adiabatic surface is as warm as what it sees
            warm = (J[rest] / SIGMA) ** 0.25 - 273.15
            print(f"adiabatic rest: {warm.min():.2f} to {warm.max():.2f} °C")
