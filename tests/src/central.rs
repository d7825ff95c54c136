//! Central control compared with a controller on each vehicle: the same ring over the same network, with and without a
//! kill of the central controller or of one agent.

use std::collections::{BTreeMap, BTreeSet};

use skein_common::message::EventKind;
use skein_lab::metrics::{Metrics, Report, Run, VehicleNow, Wall};
use skein_lab::study::{Study, measure};
use skein_lab::world::World;

use crate::{in_parallel, median_and_worst, study};

/// Time of the kill, s after the first take-off.
pub const KILLED_AT_S: u32 = 120;
/// Length of a flight, s.
const DURATION_S: u32 = 300;
/// Half the width of the ring's band, m.
const BAND_M: f64 = 20.0;

/// One kind of flight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Whether a central controller flies all vehicles.
    pub central: bool,
    /// Number of vehicles.
    pub vehicles: usize,
    /// Share of datagrams that are lost.
    pub loss: f64,
    /// Delay of each datagram, one way, s.
    pub delay_s: f64,
    /// Whether the flight has the wind and gusts of `BREEZE` instead of calm air.
    pub breeze: bool,
    /// Whether the central controller is killed, or without central control the agent of vehicle 2.
    pub killed: bool,
    /// Computing time of the central controller for a vehicle and frame, s; `None` for the default.
    pub step_s: Option<f64>,
}

/// Four vehicles with their own controllers, a perfect network, calm air, no kill.
pub const PLAIN: Case =
    Case { central: false, vehicles: 4, loss: 0.0, delay_s: 0.0, breeze: false, killed: false, step_s: None };

/// Wind of 5 m/s from the north, and light turbulence as defined by MIL-F-8785C, 15 knots at 20 ft.
const BREEZE: [&str; 2] = ["world.wind_m_s=5", "world.gust_w20_m_s=7.7"];

/// One flight.
#[derive(Clone, Debug)]
pub struct CentralFlight {
    /// Figures of the flight.
    pub report: Report,
    /// Number of live members in the band and at their altitude at the end.
    pub in_formation: usize,
    /// Largest horizontal distance of a vehicle from the ring at the end, m.
    pub strayed_m: f64,
    /// Number of vehicles whose agents reported a failure; all of these reports are false.
    pub alarms: usize,
    /// Number of heartbeats and their payload, bytes.
    agreed: (u64, u64),
}

impl Case {
    /// Changes to `hover.toml`. The ring grows with the swarm, so that neighbours stay as far apart as the paper's
    /// four, up to 200 m for eight vehicles: on a larger ring the vehicles would still be on their way at the time of
    /// the kill.
    pub fn sets(&self) -> Vec<String> {
        let radius_m = (25 * self.vehicles).min(200);
        let killed = match (self.killed, self.central) {
            (false, _) => String::new(),
            (true, true) => format!("{{ at_s = {KILLED_AT_S}, fault = \"kill_control\" }}"),
            (true, false) => format!("{{ at_s = {KILLED_AT_S}, fault = \"kill\", vehicle = 2 }}"),
        };
        let mut sets = vec![
            format!("duration_s={DURATION_S}"),
            format!("swarm.vehicles={}", self.vehicles),
            format!("formation.radius_m={radius_m}"),
            format!("network.loss={}", self.loss),
            format!("network.delay_s={}", self.delay_s),
            format!("control.mode={}", if self.central { "central" } else { "each" }),
            format!("mission.events=[{killed}]"),
        ];
        sets.extend(BREEZE.iter().filter(|_| self.breeze).map(|&set| set.to_owned()));
        sets.extend(self.step_s.map(|step_s| format!("control.central_step_s={step_s}")));
        sets
    }

    /// The study of this kind of flight.
    ///
    /// # Panics
    /// If the scenario is not valid.
    pub fn study(&self) -> Study {
        let sets = self.sets();
        study("hover.toml", &sets.iter().map(String::as_str).collect::<Vec<_>>())
    }

    /// The command line that flies this seed.
    pub fn command(&self, seed: u64) -> String {
        let sets: Vec<_> = self.sets().iter().map(|set| format!("--set '{set}'")).collect();
        format!("skein study deploy/scenarios/hover.toml --seed {seed} {}", sets.join(" "))
    }

    /// Flies this seed.
    ///
    /// # Panics
    /// If the flight cannot start.
    pub fn fly(&self, seed: u64) -> CentralFlight {
        let Study { mut scenario, aircraft, rules, .. } = self.study();
        scenario.seed = seed;
        let mut world = World::new(&scenario, &aircraft, &rules).expect("a valid scenario");
        let mut metrics = Metrics::new(&scenario, Run::new(&scenario, "study"));
        // Over a network that loses every message no vehicle ever becomes active.
        while !world.all_active() && world.t_s() < 60.0 {
            world.tick();
        }
        let (zero_s, mut vehicles) = (world.t_s(), Vec::new());
        let (mut alarms, mut agreed) = (BTreeSet::new(), BTreeMap::new());
        while world.t_s() - zero_s < f64::from(DURATION_S) {
            world.tick();
            measure(&world, zero_s, &mut metrics, &mut vehicles);
            let failed = world.events().filter(|(_, what)| matches!(what, EventKind::Failed(_)));
            alarms.extend(failed.map(|(id, _)| id));
            agreed.extend(world.vehicles().map(|(id, agent, ..)| (id, agent.heartbeats_sent())));
        }
        metrics.set_totals(world.totals());
        let (radius_m, altitude_m) = (scenario.formation.radius_m, scenario.formation.altitude_m);
        let off_m = |here: &VehicleNow| (here.truth.position.horizontal().norm() - radius_m).abs();
        let is_in = |here: &&VehicleNow| {
            let too_high_m = here.truth.position.altitude_m() - altitude_m;
            here.is_live_member() && off_m(here) <= BAND_M && too_high_m.abs() <= 0.1 * altitude_m
        };
        CentralFlight {
            in_formation: vehicles.iter().filter(is_in).count(),
            strayed_m: vehicles.iter().map(off_m).fold(0.0, f64::max),
            alarms: alarms.len(),
            agreed: agreed.values().fold((0, 0), |sum, (count, bytes)| (sum.0 + count, sum.1 + bytes)),
            report: metrics.report(Wall { wall_s: 0.0, real_time_factor: 0.0 }),
        }
    }
}

impl CentralFlight {
    /// Traffic on the network: datagrams a second, and their payload in kB/s. A state or heartbeat of an agent goes to
    /// every other agent; with central control agents send each other nothing.
    pub fn sent(&self, case: &Case) -> (f64, f64) {
        let Report { state_messages, state_bytes, .. } = self.report;
        let (messages, bytes) = match case.central {
            true => (state_messages, state_bytes),
            false => {
                let copies = case.vehicles as u64 - 1;
                ((state_messages + self.agreed.0) * copies, (state_bytes + self.agreed.1) * copies)
            }
        };
        (messages as f64 / f64::from(DURATION_S), bytes as f64 / f64::from(DURATION_S) / 1e3)
    }
}

/// One kind of flight, flown.
#[derive(Clone, Debug)]
pub struct CentralCell {
    /// The kind of flight.
    pub case: Case,
    /// Its flights, in the order of their seeds.
    pub flights: Vec<CentralFlight>,
}

/// Flies both kinds of control, with and without a kill, with these numbers of vehicles over these networks (loss, and
/// delay in s), over this many seeds.
pub fn cells(vehicles: &[usize], networks: &[(f64, f64)], seeds: u64) -> Vec<CentralCell> {
    let mut cells = Vec::new();
    for &n in vehicles {
        for &(loss, delay_s) in networks {
            for (central, killed) in [(false, false), (true, false), (false, true), (true, true)] {
                let case = Case { central, vehicles: n, loss, delay_s, killed, breeze: true, ..PLAIN };
                cells.push(CentralCell { case, flights: in_parallel(0..seeds, |seed| case.fly(seed)) });
            }
        }
    }
    cells
}

/// The table of both kinds of control, a row for each kind of flight; below it the commands that fly the worst seeds.
pub fn table(cells: &[CentralCell]) -> String {
    let rows = cells.iter().map(|cell| row(&cell.case, &cell.flights));
    let most = |central: bool| {
        let of_mode = cells.iter().filter(|cell| cell.case.central == central);
        let worst = of_mode.filter_map(|cell| Some((cell.case, worst_of(&cell.flights)?)));
        let most = worst.max_by_key(|(_, (_, flight))| flight.report.crashes);
        most.map(|(case, (seed, _))| case.command(seed))
    };
    let commands = [false, true].into_iter().filter_map(most);
    [heading()].into_iter().chain(rows).chain(commands).collect::<Vec<_>>().join("\n")
}

/// The limits of central control: the table over delays of each datagram, one way, s, and over computing times of the
/// central controller for a vehicle and frame, s.
pub fn limits(vehicles: usize, delays_s: &[f64], steps_s: &[f64], seeds: u64) -> String {
    let central = Case { central: true, vehicles, breeze: true, ..PLAIN };
    let delayed = delays_s.iter().map(|&delay_s| Case { delay_s, ..central });
    let loaded = steps_s.iter().map(|&step_s| Case { step_s: Some(step_s), ..central });
    let mut lines = vec![format!(
        "{:>8} {:>7} {:>12} {:>7} {:>13} {:>13} {:>10}",
        "delay s", "step ms", "in formation", "crashes", "radial rms m", "spacing deg", "worst seed"
    )];
    for case in delayed.chain(loaded) {
        lines.push(limits_row(&case, &in_parallel(0..seeds, |seed| case.fly(seed))));
    }
    lines.join("\n")
}

fn limits_row(case: &Case, flights: &[CentralFlight]) -> String {
    let of = |figure: fn(&CentralFlight) -> Option<f64>| median_and_worst(flights.iter().map(figure));
    format!(
        "{:>8} {:>7} {:>12} {:>7} {:>13} {:>13} {:>10}",
        case.delay_s,
        step_ms(case),
        in_formation(case, flights),
        flights.iter().map(|flight| flight.report.crashes).sum::<u64>(),
        of(|flight| flight.report.radial_rms_m),
        of(|flight| flight.report.spacing_error_deg),
        worst_of(flights).map_or_else(String::new, |(seed, _)| seed.to_string()),
    )
}

/// The mean share of vehicles that were in formation at the end.
fn in_formation(case: &Case, flights: &[CentralFlight]) -> String {
    let shares = flights.iter().map(|flight| flight.in_formation as f64 / case.vehicles as f64);
    format!("{:.1} %", 100.0 * shares.sum::<f64>() / flights.len() as f64)
}

/// Computing time of the central controller for a vehicle and frame, ms, if it is not the default.
fn step_ms(case: &Case) -> String {
    case.step_s.filter(|_| case.central).map_or_else(|| "-".to_owned(), |s| format!("{}", s * 1e3))
}

/// The worst seed: most crashes, then fewest in formation, then farthest from the ring.
fn worst_of(flights: &[CentralFlight]) -> Option<(u64, &CentralFlight)> {
    let badness = |flight: &CentralFlight| {
        let Report { crashes, radial_rms_m, .. } = flight.report;
        (crashes, std::cmp::Reverse(flight.in_formation), radial_rms_m.map(|rms_m| (rms_m * 1e3) as u64))
    };
    (0..).zip(flights).max_by_key(|(_, flight)| badness(flight))
}

fn heading() -> String {
    format!(
        "{:<8} {:>3} {:>5} {:>7} {:>7} {:>7} {:>7} {:>12} {:>7} {:>6} {:>10} {:>9} {:>15} {:>13} {:>15} {:>7} {:>7} {:>10}",
        "control",
        "N",
        "loss",
        "delay s",
        "step ms",
        "killed",
        "flights",
        "in formation",
        "crashes",
        "alarms",
        "collisions",
        "closest m",
        "strayed m",
        "radial rms m",
        "spacing deg",
        "sent /s",
        "kB/s",
        "worst seed"
    )
}

fn row(case: &Case, flights: &[CentralFlight]) -> String {
    let of = |figure: fn(&CentralFlight) -> Option<f64>| median_and_worst(flights.iter().map(figure));
    let sum = |figure: fn(&CentralFlight) -> u64| flights.iter().map(figure).sum::<u64>();
    let mean = |figure: &dyn Fn(&CentralFlight) -> f64| flights.iter().map(figure).sum::<f64>() / flights.len() as f64;
    let closest_m = flights.iter().filter_map(|flight| flight.report.min_separation_m).fold(f64::INFINITY, f64::min);
    format!(
        "{:<8} {:>3} {:>5} {:>7} {:>7} {:>7} {:>7} {:>12} {:>7} {:>6} {:>10} {closest_m:>9.1} {:>15} {:>13} {:>15} \
         {:>7.0} {:>7.1} {:>10}",
        if case.central { "central" } else { "each" },
        case.vehicles,
        case.loss,
        case.delay_s,
        step_ms(case),
        match (case.killed, case.central) {
            (false, _) => "-",
            (true, true) => "central",
            (true, false) => "agent",
        },
        flights.len(),
        in_formation(case, flights),
        sum(|flight| flight.report.crashes),
        sum(|flight| flight.alarms as u64),
        sum(|flight| flight.report.collisions),
        of(|flight| Some(flight.strayed_m)),
        of(|flight| flight.report.radial_rms_m),
        of(|flight| flight.report.spacing_error_deg),
        mean(&|flight| flight.sent(case).0),
        mean(&|flight| flight.sent(case).1),
        worst_of(flights).map_or_else(String::new, |(seed, _)| seed.to_string()),
    )
}
