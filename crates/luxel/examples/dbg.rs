use luxel::*;
fn main(){
 let settings = Settings{error:0.005, elements:Some(400), ..Settings::default()};
 let mut s = Session::new(luxel_scenes::furnace(0.5), &settings).unwrap();
 s.by_ref().for_each(drop);
 let sol=s.solution(); let f=s.front();
 let d=s.lights().element_irradiance(s.scene(), f, s.caster(), &Default::default());
 let mut v:Vec<(f64,usize)>=(0..f.len()).map(|e|(d[e*3+1] as f64,e)).collect();
 v.sort_by(|a,b|b.0.total_cmp(&a.0));
 let mean:f64=(0..f.len()).map(|e|d[e*3+1] as f64*f.area[e] as f64).sum::<f64>()/f.total_area();
 println!("n {} mean direct {}", f.len(), mean);
 for (x,e) in v.iter().take(12).chain(v.iter().rev().take(12)) { let p=f.point_on(s.scene(),luxel_core::ElementId(*e as u32),[0.5,0.5]); println!("{x} area {} at {:?} n {:?} surf {} B {}", f.area[*e], p.0,p.1, s.scene().surfaces[f.surface(luxel_core::ElementId(*e as u32)).index()].name, sol.total(*e).g);}
}
