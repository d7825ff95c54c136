//! Network impairments of the states that one agent receives from other teams.
//!
//! One channel with the settings of `[network]` carries all of them: their loss, delay, jitter, reordering, copies and range.
//! Settings for single links, the graph and cuts are about the own team.

use alloc::collections::VecDeque;
use alloc::vec::Vec;

use skein_common::frame::PositionNed;
use skein_common::id::VehicleId;
use skein_common::scenario::{Quality, Scenario};
use skein_common::time::LocalTime;

use super::Delivery;
use super::channel::{Channel, Direction};
use super::channels::{Range, only_delays};
use super::draw::{Draws, MessageKey, STRANGERS};
use crate::intent::ReceivedIntent;
use crate::strangers::StrangerState;

/// The impairments of the states of strangers at one receiver.
#[derive(Clone, Debug)]
pub struct StrangerImpairments {
    own: VehicleId,
    /// The settings of the channel, which has no bandwidth: the strangers share no link.
    quality: Quality,
    /// Random impairments; `None` if there is only the delay.
    random: Option<(Draws, Channel)>,
    range: Option<Range>,
    /// States and intents in flight, the earliest arrival first.
    in_flight: VecDeque<StrangerState>,
    intents: VecDeque<ReceivedIntent>,
}

impl StrangerImpairments {
    /// The impairments of vehicle `own` at the start of its agent.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        let quality = Quality { bandwidth_bit_s: None, ..scenario.network.quality() };
        let is_random = !only_delays(&quality) || scenario.network.range_m.is_some();
        Self {
            own,
            quality,
            random: is_random.then(|| (Draws::new(scenario.seed), Channel::default())),
            range: Range::of(&scenario.network),
            in_flight: VecDeque::new(),
            intents: VecDeque::new(),
        }
    }

    /// Whether every state arrives at once.
    pub fn is_perfect(&self) -> bool {
        self.quality.delay_s == 0.0 && self.random.is_none()
    }

    /// Takes the state that an ideal network delivers at `state.at`, and that is handed over now: it arrives at the earliest
    /// now. `own` is the receiver's position if it knows it.
    pub fn send(&mut self, state: StrangerState, now: LocalTime, own: Option<PositionNed>) {
        let distance_m = own.map(|own| (own - state.position).norm());
        let key = MessageKey::of_state(state.id, state.order);
        for at in self.arrivals(&key, state.at, now, distance_m).into_iter().flatten() {
            let place = self.in_flight.partition_point(|earlier| earlier.at <= at);
            self.in_flight.insert(place, StrangerState { at, ..state });
        }
    }

    /// Takes the intent that an ideal network delivers at `intent.at`, as [`Self::send`] takes a state. An intent has no
    /// position of its sender, so range does not apply.
    pub fn send_intent(&mut self, intent: ReceivedIntent, now: LocalTime) {
        let key = MessageKey::of_intent(intent.id, intent.order);
        for at in self.arrivals(&key, intent.at, now, None).into_iter().flatten() {
            let place = self.intents.partition_point(|earlier| earlier.at <= at);
            self.intents.insert(place, ReceivedIntent { at, ..intent });
        }
    }

    /// The arrivals of a message and its copy that an ideal network delivers at `at`, from this distance.
    fn arrivals(
        &mut self,
        key: &MessageKey,
        at: LocalTime,
        now: LocalTime,
        distance_m: Option<f64>,
    ) -> [Option<LocalTime>; 2] {
        let lost_by_distance = self.range.zip(distance_m).map_or(0.0, |(range, distance_m)| range.loss_at(distance_m));
        let Self { own, quality, .. } = self;
        let delivery = match &mut self.random {
            None => Delivery::Arrives { at: at.plus_seconds(quality.delay_s), copy_at: None },
            // The size matters for the bandwidth alone, which is without limit here.
            Some((draws, channel)) => {
                let direction = Direction { sender: STRANGERS, receiver: *own, quality };
                channel.fate(draws, &direction, (key, || 0), at, lost_by_distance)
            }
        };
        match delivery {
            Delivery::Arrives { at, copy_at } => [Some(at), copy_at].map(|at| at.map(|at| at.max(now))),
            _ => [None; 2],
        }
    }

    /// Appends to `out` the intents received by `now`, in the order of their arrival.
    pub fn receive_intents(&mut self, now: LocalTime, out: &mut Vec<ReceivedIntent>) {
        while let Some(intent) = self.intents.pop_front_if(|intent| intent.at <= now) {
            out.push(intent);
        }
    }

    /// Appends to `out` the states received by `now`, in the order of their arrival.
    pub fn receive(&mut self, now: LocalTime, out: &mut Vec<StrangerState>) {
        while let Some(state) = self.in_flight.pop_front_if(|state| state.at <= now) {
            out.push(state);
        }
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::VelocityNed;
    use skein_common::id::Incarnation;
    use skein_common::message::MessageOrder;
    use skein_common::scenario::{Source, load};

    use super::*;

    /// Shares of a thousand states that have arrived after 0.25 s and after 2 s, from this distance.
    fn received(keys: &str, distance_m: f64) -> (f64, f64) {
        let text = alloc::format!("swarm.vehicles = 2\n{keys}");
        let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
        let mut impairments = StrangerImpairments::new(&scenario, VehicleId::new(1).unwrap());
        let own = PositionNed::new(0.0, 0.0, -30.0);
        for sequence in 0..1000 {
            let state = StrangerState {
                id: "2/1".parse().unwrap(),
                order: MessageOrder { incarnation: Incarnation(1), sequence },
                position: PositionNed::new(distance_m, 0.0, -30.0),
                velocity: VelocityNed::new(0.0, 0.0, 0.0),
                at: LocalTime::from_seconds(1.0),
            };
            impairments.send(state, state.at, Some(own));
        }
        let mut out = Vec::new();
        impairments.receive(LocalTime::from_seconds(1.25), &mut out);
        let soon = out.len() as f64 / 1000.0;
        impairments.receive(LocalTime::from_seconds(3.0), &mut out);
        assert!(out.is_sorted_by_key(|state| state.at));
        (soon, out.len() as f64 / 1000.0)
    }

    #[test]
    fn states_of_strangers_are_lost_delayed_and_out_of_range_as_the_network_says() {
        assert_eq!(received("", 100.0), (1.0, 1.0));
        assert_eq!(received("network.delay_s = 0.3", 100.0), (0.0, 1.0));
        let (soon, late) = received("network.loss = 0.2\nnetwork.delay_s = 0.2", 100.0);
        assert!(soon == late && (0.75..0.85).contains(&late), "{late}");
        let (soon, late) = received("network.jitter_s = 0.5", 100.0);
        assert!((0.4..0.6).contains(&soon) && late == 1.0, "{soon} {late}");
        assert_eq!(received("network.range_m = 90", 100.0).1, 0.0);
    }
}
