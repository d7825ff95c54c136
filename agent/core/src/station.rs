//! The vehicle station: what surrounds the agent of one vehicle wherever it runs. The control thread and the study drive it
//! in the same way: [`Station::hear`], [`Station::step`], [`Station::trace`].
//!
//! ```text
//!   messages --> impairments --> clock of this vehicle --> Agent::step --> outputs, trace
//! ```
//!
//! Its callers have a right clock; what the scenario sets wrong about this vehicle's clock is added here, after the
//! impairments, because the network knows nothing of a vehicle's clock.

use alloc::vec::Vec;

use skein_common::id::{Incarnation, VehicleId};
use skein_common::message::Trace;
use skein_common::scenario::Scenario;
use skein_common::state::Membership;
use skein_common::time::{LocalTime, Now, PlantTime};

use crate::agent::{Agent, Inputs, Outputs};
use crate::aircraft::Aircraft;
use crate::control::Rules;
use crate::formation::NotFlown;
use crate::formation::external::Answer;
use crate::impairments::{Ear, Tally, Whereabouts};
use crate::peers::Heard;
use crate::plant::{Measurement, Truth};
use crate::skew::Skew;

/// What outlives an agent: how wrong the vehicle's clock is, and when the vehicle took off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Clocks {
    skew: Skew,
    /// When the vehicle first became an active member, by the right clock.
    took_off: Option<LocalTime>,
    /// How long an earlier agent had flown the vehicle when the right clock began, s.
    flown_before_s: Option<f64>,
}

impl Clocks {
    /// The clocks of vehicle `own` on the ground.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        Self { skew: Skew::new(scenario, own), ..Self::default() }
    }

    /// The same of a vehicle that an earlier agent had flown for so long, s, when the right clock began; `None` if there was
    /// no earlier agent.
    #[must_use]
    pub fn after(self, flown_before_s: Option<f64>) -> Self {
        Self { flown_before_s, ..self }
    }

    /// The vehicle's clock jumps forward, or back if negative, s.
    pub fn jump(&mut self, by_s: f64) {
        self.skew.jump(by_s);
    }

    /// What the vehicle's clock shows when the right one shows `right`.
    pub fn shown(&self, right: LocalTime) -> LocalTime {
        self.skew.shown(right)
    }

    /// Time since the vehicle's take-off, under whichever agent, s: what scripted events count by. `None` before it.
    pub fn flown_s(&self, right: LocalTime) -> Option<f64> {
        // Divided, not multiplied: the nearest number to what the scenario's decimals say.
        let since = |took_off: LocalTime| (right.nanoseconds().saturating_sub(took_off.nanoseconds())) as f64 / 1e9;
        self.flown_before_s.map(|before_s| before_s + right.seconds()).or(self.took_off.map(since))
    }
}

/// One vehicle's agent with its clocks and with the scenario's network in front of it.
#[derive(Clone, Debug)]
pub struct Station {
    agent: Agent,
    impairments: Ear,
    clocks: Clocks,
    /// What has arrived since the last step, stamped by the vehicle's clock.
    heard: Vec<Heard>,
}

impl Station {
    /// A new life of vehicle `own`, with the clocks that its earlier life left.
    ///
    /// # Errors
    /// A scenario that asks for what is not flown.
    pub fn new(
        scenario: &Scenario,
        own: VehicleId,
        incarnation: Incarnation,
        (aircraft, rules): (&Aircraft, Rules),
        clocks: Clocks,
    ) -> Result<Self, NotFlown> {
        let agent = Agent::new(scenario, own, incarnation, aircraft, rules)?;
        Ok(Self { agent, impairments: Ear::new(scenario, own), clocks, heard: Vec::new() })
    }

    /// Takes in what a perfect network delivers, each message with the right time of its arrival. What gets through the
    /// impairments by now waits for the next step.
    pub fn hear(&mut self, right: LocalTime, arriving: impl IntoIterator<Item = Heard>) {
        let own = Whereabouts { flown_s: self.clocks.flown_s(right), position: self.agent.position() };
        let before = self.heard.len();
        self.impairments.hear(right, own, arriving, &mut self.heard);
        if !self.clocks.skew.is_none() {
            self.heard[before..].iter_mut().for_each(|heard| heard.at = self.clocks.shown(heard.at));
        }
    }

    /// Steps the agent at this right time. `measurement` is that of a new frame, `None` if none came in time; `plant_time` is
    /// the time of the newest frame. `leave` asks this vehicle alone to land and leave. `answer` is that of an external law.
    pub fn step(
        &mut self,
        right: LocalTime,
        (plant_time, measurement): (PlantTime, Option<&Measurement>),
        leave: bool,
        answer: Option<&Answer>,
    ) -> Outputs {
        let now = Now { plant: plant_time, local: self.clocks.shown(right) };
        let outputs = self.agent.step(now, &Inputs { measurement, heard: &self.heard, leave, answer });
        self.heard.clear();
        if self.agent.membership() == Membership::Active {
            self.clocks.took_off.get_or_insert(right);
        }
        outputs
    }

    /// The record of the last step, but for what only a PC in real time can tell: how long the step took, and frames that it
    /// came too late for. `truth` is the plant's.
    pub fn trace(&mut self, right: LocalTime, plant_time: PlantTime, truth: &Truth) -> Trace {
        let now = Now { plant: plant_time, local: self.clocks.shown(right) };
        let mut trace = self.agent.trace(now, truth);
        self.impairments.tell_lateness(&mut trace.peers);
        trace
    }

    /// The agent.
    pub fn agent(&self) -> &Agent {
        &self.agent
    }

    /// The clocks, as the next life of the vehicle needs them.
    pub fn clocks(&self) -> &Clocks {
        &self.clocks
    }

    /// The vehicle's clock jumps forward, or back if negative, s.
    pub fn clock_jumps(&mut self, by_s: f64) {
        self.clocks.jump(by_s);
    }

    /// Before the next step: the PC did not let this agent run for so long, s.
    pub fn did_not_run(&mut self, for_s: f64) {
        self.agent.did_not_run(for_s);
    }

    /// What became of all messages on the scenario's network; `None` where that network changes nothing.
    pub fn impaired(&self) -> Option<Tally> {
        (!self.impairments.is_perfect()).then(|| self.impairments.tally())
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};

    use super::*;

    fn clocks(keys: &str) -> Clocks {
        let text = alloc::format!("swarm.vehicles = 2\n{keys}");
        let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
        Clocks::new(&scenario, VehicleId::new(1).unwrap())
    }

    #[test]
    fn flight_time_counts_from_take_off_or_goes_on_from_an_earlier_agent() {
        let at = |seconds: f64| LocalTime::from_seconds(seconds);
        let ground = clocks("");
        assert_eq!(ground.flown_s(at(5.0)), None);
        let flying = Clocks { took_off: Some(at(3.0)), ..ground };
        assert_eq!(flying.flown_s(at(3.7)), Some(0.7), "the nearest number to the decimal");
        assert_eq!(flying.after(Some(100.0)).flown_s(at(5.0)), Some(105.0));
        assert_eq!(ground.after(Some(100.0)).flown_s(at(0.0)), Some(100.0));
    }

    #[test]
    fn jumps_add_up_on_top_of_a_wrong_clock() {
        let mut clocks = clocks("[vehicle.1]\nclock_offset_s = 10");
        let right = LocalTime::from_seconds(100.0);
        let shown = |clocks: &Clocks| clocks.shown(right).nanoseconds();
        assert_eq!(shown(&clocks), 110_000_000_000);
        clocks.jump(7.0);
        clocks.jump(-2.0);
        assert_eq!(shown(&clocks), 115_000_000_000);
        assert_eq!(clocks.flown_s(right), None, "a clock that is set changes no flight time");
    }
}
