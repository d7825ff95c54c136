//! One agent without threads, sockets, files and clocks of its own, for tests of whole swarms in virtual time.
//!
//! The test is the operating system and the network: it wakes the control loop, runs the publisher, forms and ends links,
//! and carries the bytes. The control loop, the link's processing of messages and the station are those of the real agent.
//! It has no external law, keeps no inputs and publishes no health or summary.

use std::sync::Arc;
use std::time::{Duration, Instant};

use skein_common::frame::Origin;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::scenario::Scenario;
use skein_core::agent::{Agent, Outputs};
use skein_core::aircraft::Aircraft;
use skein_core::control::Rules;
use skein_core::energy::Energy;
use skein_core::formation::UnsupportedScenario;
use skein_core::peers::Received;
use skein_core::plant::{Plant, Wake};
use skein_core::station::{Clocks, Station};
use skein_host::clock::LocalClock;
use tokio::sync::mpsc;

use super::Stop;
use super::control::{Control, LoopState};
use super::timing::Timing;
use crate::link::Trust;
pub use crate::link::simulated::{LinkSizes, Put, SimulatedEnd};

/// An agent in virtual time. All instants are those of its computer's monotonic clock.
pub struct SimulatedAgent {
    control: Control,
    /// The network's end of its link.
    pub network: SimulatedEnd,
    /// The messages from peers and operators that entered the station in the last step.
    pub received: Vec<Received>,
}

/// The result of one pass of the control loop.
#[derive(Debug)]
pub struct SimulatedStep {
    /// The outputs of the station.
    pub outputs: Outputs,
    /// Whether the agent reports to its supervisor that its control thread runs.
    pub reports: bool,
}

impl SimulatedAgent {
    /// The agent of vehicle `own`, started at this instant. `flown_s` is the time for which an earlier agent had flown the
    /// vehicle, s.
    ///
    /// # Errors
    /// A scenario with a formation that this program cannot fly.
    pub fn start(
        scenario: &Scenario,
        (own, incarnation): (VehicleId, Incarnation),
        (aircraft, rules): (&Aircraft, Rules),
        (plant, flown_s): (Box<dyn Plant>, Option<f64>),
        trust: Trust,
        now: Instant,
    ) -> Result<Self, UnsupportedScenario> {
        let clocks = Clocks::new(scenario, own).after(flown_s);
        let station = Station::new(scenario, own, incarnation, (aircraft, rules), clocks)?;
        let clock = LocalClock::zero_at(now);
        let (link, network) = SimulatedEnd::new(own, clock, trust);
        let origin = Origin::new(scenario.origin.geodetic());
        let period = Duration::from_secs_f64(plant.frame_period_s());
        let (health, _) = mpsc::channel(1);
        let control = Control {
            station,
            plant,
            plant_name: "builtin",
            release: super::release(),
            link,
            law: None,
            clock,
            origin,
            own_origin: origin,
            neighbourhood: None,
            own,
            incarnation,
            stop: Arc::new(Stop::default()),
            health,
            recorder: None,
            energy: Energy::new(None),
            timing: Timing::new(period, now),
            kept: LoopState::default(),
        };
        Ok(Self { control, network, received: Vec::new() })
    }

    /// One pass of the control loop that takes no time.
    pub fn step(&mut self, Wake { frame, status }: Wake, now: Instant) -> SimulatedStep {
        let Self { control, received, .. } = self;
        let frame = frame.as_ref();
        control.kept.inputs.status = status;
        control.take_inputs(frame, now);
        received.clone_from(&control.kept.inputs.received);
        let outputs = control.step();
        let reports = control.report(frame, outputs.clone(), (now, now)).is_some();
        SimulatedStep { outputs, reports }
    }

    /// The agent that decides.
    pub fn agent(&self) -> &Agent {
        self.control.station.agent()
    }
}
