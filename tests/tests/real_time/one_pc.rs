//! Ten agents on one PC for ten X-Planes, in real time; and the death of that PC.
#![cfg(target_os = "linux")]

use skein_tests::one_pc::{Cores, OnePc, X_PLANES, printed};
use skein_tests::share::Share;

const FLOWN_S: u64 = 60;
/// Largest share of late steps: a PC of CI does other work meanwhile.
const LATE_SHARE: f64 = 0.01;

#[test]
fn ten_agents_on_one_pc_hold_the_ring_and_their_x_planes_are_given_back_after_its_death() {
    let _share = Share::of(120);
    let folder = tempfile::tempdir().unwrap();
    let mut pc = OnePc::start(env!("CARGO_BIN_EXE_skein-under-test").as_ref(), folder.path(), Cores::Shared);
    let (load, metrics) = pc.fly(FLOWN_S);
    let figure = |key: &str| metrics[key].as_f64().unwrap_or_else(|| panic!("{key} in {metrics:#}"));
    println!(
        "ten agents: {:.2} cores, skein fly: {:.2}; at altitude {:.1} s, in band {:.1} s, least separation {:.1} m, \
         {} late steps, step p99 {:.0} us",
        load.agents_cores,
        load.fly_cores,
        figure("at_altitude_s"),
        figure("in_band_s"),
        figure("min_separation_m"),
        figure("frame_overruns"),
        figure("step_p99_us"),
    );
    assert!(figure("at_altitude_s") <= 20.0 && figure("in_band_s") <= 30.0, "{metrics:#}");
    assert!(figure("min_separation_m") >= 10.0 && figure("max_tilt_deg") <= 25.0, "{metrics:#}");
    assert!(figure("collisions") == 0.0 && figure("crashes") == 0.0, "{metrics:#}");
    let steps = f64::from(X_PLANES) * 50.0 * FLOWN_S as f64;
    assert!(figure("frame_overruns") < LATE_SHARE * steps, "{metrics:#}");

    pc.die();
    let released = pc.command("xplane").arg("release").args(OnePc::x_planes()).output().unwrap();
    assert!(released.status.success(), "{}", printed(&released));
    let expected: String = OnePc::x_planes().iter().map(|at| format!("{at}: the controls are given back\n")).collect();
    assert_eq!(printed(&released), expected, "every X-Plane had kept its overrides");
    let again = printed(&pc.command("xplane").arg("release").args(OnePc::x_planes()).output().unwrap());
    assert_eq!(again.matches("the controls were free already").count(), usize::from(X_PLANES), "{again}");
}
