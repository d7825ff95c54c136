//! Three vehicles of which one agent's PC is suspended and resumes: every agent has its own clock, and its own helicopter.

use alloc::collections::BTreeMap;

use super::*;
use crate::helicopter::{BuiltInVehicle, Start, TICK_S, Weather};
use crate::station::{Clocks, Station, StepInputs};
use crate::tests::origin;

/// Time after which the suspended PC has its links again, s.
const LINKS_BACK_S: f64 = 1.0;
/// Nearest that two vehicles may come to each other after the PC resumes, m.
const APART_M: f64 = 8.0;

/// How a PC is suspended.
#[derive(Clone, Copy, Debug)]
struct Suspension {
    for_s: f64,
    /// Whether the agent's clock counts that time. Linux's does not; that of a virtual machine, or of another system, may.
    clock_runs: bool,
    /// Whether the simulator runs on another PC, where the helicopter flies on with the last controls.
    helicopter_flies_on: bool,
}

/// One vehicle with its agent.
struct Flown {
    station: Station,
    helicopter: BuiltInVehicle,
    controls: Option<Controls>,
    /// How far its clock is behind that of the others, s.
    behind_s: f64,
    inbox: Vec<PeerMessage>,
    events: Vec<EventKind>,
}

impl Flown {
    /// Steps the agent with a new frame; returns what it sends.
    fn step(&mut self, now_s: f64, did_not_run_s: Option<f64>) -> Vec<PeerMessage> {
        let right = LocalTime::from_seconds(now_s - self.behind_s);
        let frame = self.helicopter.frame();
        let received = core::mem::take(&mut self.inbox).into_iter().map(|message| Received { message, at: right });
        let mut inputs = StepInputs {
            right,
            did_not_run_s,
            received: received.collect(),
            plant_time: frame.time,
            measurement: Some(frame.measurement),
            ..StepInputs::default()
        };
        let Outputs { command, outbox, .. } = self.station.step_with(&mut inputs, &mut Workspace::default());
        let controls = command.and_then(Command::controls);
        assert!(controls.is_none_or(|controls| controls.is_within_limits()), "{controls:?} at {now_s} s");
        self.controls = controls;
        self.events.extend(outbox.happened);
        let state = outbox.state.map(|state| received_state(*state));
        state.into_iter().chain(outbox.mission.map(|heartbeat| PeerMessage::Mission(*heartbeat))).collect()
    }

    fn take_events(&mut self) -> Vec<EventKind> {
        core::mem::take(&mut self.events)
    }
}

struct Swarm {
    now_s: f64,
    vehicles: Vec<Flown>,
    /// Messages of the last step, with their senders.
    sent: Vec<(usize, PeerMessage)>,
}

impl Swarm {
    fn new() -> Self {
        let sets = ["swarm.vehicles=3".to_owned(), "formation.radius_m=40".to_owned()];
        let scenario = load(&Source { name: "test.toml", text: "" }, &sets).unwrap().scenario;
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        let vehicle = |number: u8| {
            let start = Start { north_m: 40.0 * f64::from(number), ..Start::default() };
            let weather = Weather::from(&scenario.world);
            let parameters = aircraft.helicopter.as_ref().unwrap();
            let parts = (&aircraft, Rules::shipped());
            Flown {
                station: Station::new(&scenario, id(number), Incarnation(1), parts, Clocks::default()).unwrap(),
                helicopter: BuiltInVehicle::new(&origin(), parameters, &start, &weather, 1, id(number)),
                controls: None,
                behind_s: 0.0,
                inbox: Vec::new(),
                events: Vec::new(),
            }
        };
        Self { now_s: 0.0, vehicles: [1, 2, 3].map(vehicle).into(), sent: Vec::new() }
    }

    /// Runs one frame of all vehicles but `asleep`. The messages to and from `cut_off` are lost.
    fn frame(&mut self, asleep: Option<usize>, cut_off: Option<usize>, did_not_run_s: Option<f64>) {
        self.now_s += TICK_S;
        let sent = core::mem::take(&mut self.sent);
        for (nth, vehicle) in self.vehicles.iter_mut().enumerate().filter(|(nth, _)| Some(*nth) != asleep) {
            let arrives = |sender: usize| sender != nth && Some(sender) != cut_off && Some(nth) != cut_off;
            vehicle.inbox.extend(sent.iter().filter(|(sender, _)| arrives(*sender)).map(|(_, message)| *message));
            let messages = vehicle.step(self.now_s, did_not_run_s.filter(|_| nth == 0));
            self.sent.extend(messages.into_iter().map(|message| (nth, message)));
            vehicle.helicopter.advance(vehicle.controls);
        }
    }

    fn run(&mut self, seconds: f64, cut_off: Option<usize>) {
        let frames = (seconds / TICK_S).round() as usize;
        (0..frames).for_each(|_| self.frame(None, cut_off, None));
    }

    /// Suspends the first vehicle's PC and resumes it.
    fn suspend(&mut self, Suspension { for_s, clock_runs, helicopter_flies_on }: Suspension) {
        for _ in 0..(for_s / TICK_S).round() as usize {
            self.frame(Some(0), Some(0), None);
            if helicopter_flies_on {
                self.vehicles[0].helicopter.advance(None);
            }
        }
        self.vehicles[0].behind_s += if clock_runs { 0.0 } else { for_s };
        self.frame(None, Some(0), clock_runs.then_some(for_s));
    }

    fn nearest_m(&self) -> f64 {
        let places = self.vehicles.iter().map(|vehicle| vehicle.helicopter.frame().truth.position);
        let places: Vec<_> = places.collect();
        let pairs = [(0, 1), (0, 2), (1, 2)];
        pairs.map(|(one, other)| (places[one] - places[other]).norm()).into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// Largest difference of two sets of controls.
fn apart(one: Controls, other: Controls) -> f64 {
    let axes = [one.roll - other.roll, one.pitch - other.pitch, one.yaw - other.yaw, one.collective - other.collective];
    axes.into_iter().map(f64::abs).fold(0.0, f64::max)
}

#[test]
fn an_agent_whose_pc_was_suspended_flies_on_and_rejoins_its_swarm() {
    for suspension in [
        Suspension { for_s: 600.0, clock_runs: true, helicopter_flies_on: false },
        Suspension { for_s: 600.0, clock_runs: false, helicopter_flies_on: false },
        Suspension { for_s: 3.0, clock_runs: true, helicopter_flies_on: true },
        Suspension { for_s: 3.0, clock_runs: false, helicopter_flies_on: true },
    ] {
        let mut swarm = Swarm::new();
        swarm.run(90.0, None);
        let members = |swarm: &Swarm| {
            swarm.vehicles.iter().map(|flown| flown.station.agent().formation.live()).collect::<Vec<_>>()
        };
        assert_eq!(members(&swarm), [3, 3, 3]);
        let before = swarm.vehicles[0].controls.unwrap();
        swarm.vehicles.iter_mut().for_each(|vehicle| drop(vehicle.take_events()));

        swarm.suspend(suspension);
        let lost: BTreeMap<_, _> = (1..3).map(|nth| (nth, swarm.vehicles[nth].take_events())).collect();
        assert!(lost.values().all(|events| *events == [EventKind::PeerLost(id(1))]), "{suspension:?}: {lost:?}");
        let jump = apart(before, swarm.vehicles[0].controls.unwrap());
        println!("{suspension:?}: the controls change by {jump:.3} in the first step");
        let events = swarm.vehicles[0].take_events();
        let expected = (suspension.clock_runs && suspension.for_s > 10.0).then_some(EventKind::ClockJumped);
        assert_eq!(events, Vec::from_iter(expected), "{suspension:?}");

        swarm.run(LINKS_BACK_S, Some(0));
        let (mut nearest_m, mut lowest_m, mut tilt_deg) = (f64::INFINITY, f64::INFINITY, 0.0_f64);
        for _ in 0..(90.0 / TICK_S) as usize {
            swarm.frame(None, None, None);
            nearest_m = nearest_m.min(swarm.nearest_m());
            let truth = swarm.vehicles[0].helicopter.frame().truth;
            lowest_m = lowest_m.min(truth.height_m);
            let attitude = truth.attitude;
            tilt_deg = tilt_deg.max(attitude.roll_rad.abs().max(attitude.pitch_rad.abs()).to_degrees());
        }
        println!("nearest {nearest_m:.1} m, lowest {lowest_m:.1} m, tilt {tilt_deg:.1}°");
        assert!(jump < 0.1 && nearest_m > APART_M && lowest_m > 25.0 && tilt_deg < 30.0, "{suspension:?}");
        for vehicle in &mut swarm.vehicles[1..] {
            assert_eq!(vehicle.take_events(), [EventKind::PeerFound(id(1))], "{suspension:?}");
        }
        // A clock that stood still does not show that the links need time to come back.
        let loses_peers = swarm.vehicles[0].take_events().contains(&EventKind::AllPeersLost);
        assert_eq!(loses_peers, !suspension.clock_runs, "{suspension:?}");
        assert_eq!(members(&swarm), [3, 3, 3], "{suspension:?}");
        for flown in &swarm.vehicles {
            let agent = flown.station.agent();
            assert_eq!((agent.membership(), agent.activity()), (Membership::Active, Activity::Formation));
        }
    }
}
