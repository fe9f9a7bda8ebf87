use luxel_io::*;
fn main() {
    for a in std::env::args().skip(1) {
        let t0 = std::time::Instant::now();
        let d = match read(std::path::Path::new(&a), &ReadOptions { max_reflectance: 1.0, ..Default::default() }) { Ok(d) => d, Err(e) => { println!("{e}"); continue } };
        let t = t0.elapsed();
        let s = &d.scene;
        let (mut area, mut rho, mut flux, mut cov) = (0.0f64, [0.0f64; 3], 0.0f64, 0.0f64);
        for t in 0..s.triangles.len() {
            let f = s.finish_of(t);
            let ar = s.area(t) as f64;
            let (mut r, mut l, mut c) = ([0.0f64; 3], 0.0f64, 0.0f64);
            for k in 0..64 {
                let (mut u, mut v) = ((0.5 + k as f64 * 0.7548776662) % 1.0, (0.5 + k as f64 * 0.5698402910) % 1.0);
                if u + v > 1.0 { u = 1.0 - u; v = 1.0 - v; }
                let x = s.reflectance_at(t, u as f32, v as f32).to_array();
                for b in 0..3 { r[b] += x[b] as f64 / 64.0; }
                l += s.luminance_at(t, u as f32, v as f32).luminance() as f64 / 64.0;
                c += if f.transparent { f.coverage as f64 } else { s.coverage_at(t, u as f32, v as f32) as f64 } / 64.0 * if f.transparent { 64.0 / 64.0 } else { 1.0 };
            }
            area += ar;
            if !f.transparent { for b in 0..3 { rho[b] += ar * r[b]; } cov += ar * c; }
            flux += std::f64::consts::PI * ar * l * if f.back_emits { 2.0 } else { 1.0 };
        }
        println!("{} {} area {:.6} rhoA {:.5} {:.5} {:.5} cov {:.5} flux {:.5} lamps {} {:.0?}", a.rsplit('/').next().unwrap(), s.triangles.len(), area, rho[0], rho[1], rho[2], cov, flux, s.luminaires.len(), t);
    }
}
