//! One agent without threads, sockets, files and clocks of its own, for tests of whole swarms in virtual time.
//!
//! The test is the operating system and the network: it wakes the control loop, runs the publisher, forms and ends links,
//! and carries the bytes. The control loop, the link's processing of messages and the station are those of the real agent.
//! It has no external law, keeps no inputs and publishes no health or summary.

use std::sync::Arc;
use std::time::{Duration, Instant};

use skein_common::frame::Origin;
use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::Drops;
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
use crate::link::Trust;
use crate::link::simulated::SimulatedEnd;
pub use crate::link::simulated::{LinkSizes, Put};

/// An agent in virtual time. All instants are those of its computer's monotonic clock.
pub struct SimulatedAgent {
    control: Control,
    kept: LoopState,
    network: SimulatedEnd,
    /// The messages that entered the station in the last step from the network.
    received: Vec<Received>,
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
        let (link, network) = SimulatedEnd::new(own, trust);
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
            clock: LocalClock::zero_at(now),
            origin,
            own_origin: origin,
            neighbourhood: None,
            own,
            incarnation,
            stop: Arc::new(Stop::default()),
            health,
            recorder: None,
            energy: Energy::new(None),
        };
        Ok(Self { control, kept: LoopState::new(period, now), network, received: Vec::new() })
    }

    /// One pass of the control loop that takes no time.
    pub fn step(&mut self, Wake { frame, status }: Wake, now: Instant) -> SimulatedStep {
        let Self { control, kept, received, .. } = self;
        let frame = frame.as_ref();
        kept.inputs.status = status;
        control.take_inputs(frame, now, kept);
        received.clone_from(&kept.inputs.received);
        let outputs = control.step(kept);
        let reports = control.report(frame, outputs.clone(), (now, now), kept).is_some();
        SimulatedStep { outputs, reports }
    }

    /// Makes an observer of the trace appear or vanish.
    pub fn set_traced(&self, is_traced: bool) {
        self.network.set_traced(is_traced);
    }

    /// Publishes the messages that wait, as the publisher's thread does.
    pub fn publish(&mut self) -> Vec<Put> {
        self.network.publish(&self.control.link)
    }

    /// Takes a message that arrived on a link.
    pub fn receive(&self, key: &str, bytes: &[u8], now: Instant) {
        self.network.receive(key, bytes, self.control.clock.at(now));
    }

    /// Registers a link with a peer under the peer's certificate. It lasts until [`Self::link_ends`] with the same number.
    pub fn link_forms(&mut self, number: u64, with: VehicleId, now: Instant) {
        self.network.link_forms(number, with.into(), self.control.clock.at(now));
    }

    /// Ends the link with this number.
    pub fn link_ends(&mut self, number: u64, now: Instant) {
        self.network.link_ends(number, self.control.clock.at(now));
    }

    /// Whether the agent takes messages of this vehicle.
    pub fn is_linked(&self, with: VehicleId) -> bool {
        self.network.may_send(with.into())
    }

    /// The reply to a peer that queries the last heartbeat; `None` before the first heartbeat.
    pub fn last_heartbeat(&self) -> Option<Vec<u8>> {
        self.network.last_heartbeat()
    }

    /// The messages from peers and operators that entered the station in the last step.
    pub fn received(&self) -> &[Received] {
        &self.received
    }

    /// The agent that decides.
    pub fn agent(&self) -> &Agent {
        self.control.station.agent()
    }

    /// Numbers of entries in the memory of the link.
    pub fn sizes(&self) -> LinkSizes {
        self.network.sizes(&self.control.link)
    }

    /// Number of messages that the link refused, by reason.
    pub fn drops(&self) -> Drops {
        self.network.drops()
    }
}
