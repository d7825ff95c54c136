//! Comparison of the control laws with the same helicopters and the same moving centre.

use std::num::NonZeroUsize;

use skein_core::formation::laws::built_in;
use skein_core::formation::slots::Slots;
use skein_lab::metrics::Report;
use skein_lab::world::World;
use skein_tests::study;

const TWO: NonZeroUsize = NonZeroUsize::MIN.saturating_add(1);

fn follow(sets: &[&str]) -> Vec<Report> {
    study("laws.toml", sets).fly_all(0..2, TWO, |_| {}).unwrap()
}

/// No vehicle is lost, left behind or hit under any law: all stay within this distance of the centre, and this far
/// apart.
#[test]
fn under_every_law_eight_vehicles_follow_the_centre() {
    let limits = [
        ("ring", 90.0, 14.0),
        ("flock", 80.0, 20.0),
        ("olfati-saber", 80.0, 15.0),
        ("vasarhelyi", 80.0, 15.0),
        ("virtual-structure", 90.0, 7.0),
        ("displacement-consensus", 90.0, 7.0),
    ];
    assert_eq!(limits.map(|(law, ..)| law)[..], built_in(), "every law has limits");
    for (law, farthest_m, nearest_m) in limits {
        for report in follow(&[&format!("formation.law={law}")]) {
            let seed = report.run.seed;
            let (far_m, near_m) = (report.max_centre_distance_m.unwrap(), report.min_separation_m.unwrap());
            assert_eq!((report.collisions, report.setpoints_reached), (0, Some(2)), "{law}, seed {seed}");
            assert!(far_m < farthest_m, "{law}, seed {seed}: {far_m} m from the centre");
            assert!(near_m > nearest_m, "{law}, seed {seed}: {near_m} m apart");
            assert!(report.polarization.unwrap() > 0.98, "{law}, seed {seed}: they fly in one direction: {report:?}");
        }
    }
}

/// The parameter set evolved for 4 m/s, at 4 m/s without the safety filter: the law itself keeps the vehicles apart.
#[test]
fn the_published_set_of_vasarhelyi_flies_without_collisions_at_its_speed() {
    for vehicles in [8, 16] {
        let count = format!("swarm.vehicles={vehicles}");
        let sets = ["formation.law=vasarhelyi", "formation.safety_filter=none", "mission.speed_m_s=4", &count];
        for report in follow(&sets) {
            let near_m = report.min_separation_m.unwrap();
            assert!(report.collisions == 0 && near_m > 10.0, "{vehicles}, seed {}: {near_m} m", report.run.seed);
            assert!(report.polarization.unwrap() > 0.99 && report.setpoints_reached == Some(2), "{report:?}");
        }
    }
}

/// Every pattern is flown to within metres, and is closed up after the loss of a vehicle.
#[test]
fn exactly_the_live_vehicles_have_slots() {
    for law in ["virtual-structure", "displacement-consensus"] {
        for pattern in ["circle", "line", "v", "grid"] {
            let sets = [
                &format!("formation.law={law}"),
                &format!("formation.slots.pattern={pattern}"),
                "formation.radius_m=60",
                "formation.heading_deg=30",
                "swarm.vehicles=6",
                "mission.steps=[{ centre_ne_m = [40, -20] }]",
                "mission.events=[{ at_s = 90, fault = 'kill', vehicle = 2 }]",
            ];
            let study = study("laws.toml", &sets);
            let mut world = World::new(&study.scenario, &study.aircraft, &study.rules).unwrap();
            let slots = Slots::of(&study.scenario.formation);
            let centre = nalgebra::Vector2::new(40.0, -20.0);
            let mut all_within_3_m = |until_s: f64| {
                while world.t_s() < until_s {
                    world.tick();
                }
                let agents: Vec<_> = world.all_vehicles().filter(|(_, agent, ..)| agent.is_some()).collect();
                let is_by_rank = law == "virtual-structure";
                for (rank, (id, _, truth, _)) in agents.iter().enumerate() {
                    let nth = usize::from(id.get()) - 1;
                    let slot = if is_by_rank { slots.slot_ne_m(rank, agents.len()) } else { slots.slot_ne_m(nth, 6) };
                    let off_m = (truth.position.horizontal() - centre - slot).norm();
                    assert!(off_m < 3.0, "{law}, {pattern}, {until_s} s: vehicle {id} is {off_m} m from its slot");
                }
                agents.len()
            };
            assert_eq!(all_within_3_m(88.0), 6);
            assert_eq!(all_within_3_m(170.0), 5, "one agent was killed");
        }
    }
}
