//! scratch
use skein::study::*; use skein_agent::{aircraft::Aircraft,control::Rules}; use skein_common::scenario::*;
fn main(){ let a:Vec<String>=std::env::args().collect();
 let text=std::fs::read_to_string(&a[1]).unwrap(); let sets:Vec<String>=a[3..].to_vec();
 let l=load(&Source{name:&a[1],text:&text},&sets).unwrap(); let n:u64=a[2].parse().unwrap();
 let study=Study{aircraft: l.scenario.ids().map(|_|Aircraft::shipped("xcell60").unwrap().unwrap()).collect(), scenario:l.scenario, rules:Rules::shipped()};
 let bar=progress(n);
 let t=std::time::Instant::now();
 let r=study.fly_all(0..n, std::num::NonZeroUsize::new(2).unwrap(), |_| bar.inc(1)).unwrap(); 
 let w=t.elapsed().as_secs_f64();
 for (k,f) in summarize(&r){ println!("{k:22} n {:3} never {} median {:?} worst {:?} @{:?} [{:?} {:?}]",f.n,f.never,f.median,f.worst,f.worst_seed,f.min,f.max);} 
 println!("{w} s");
}
