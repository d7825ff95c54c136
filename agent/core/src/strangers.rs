//! The strangers stage: the vehicles of other teams that share the air.
//!
//! Across the teams of a fleet only states travel. A stranger's mission and law are unknown, and it may know nothing of
//! this vehicle: it is an obstacle that moves, and the safety filter keeps clear of it alone. Its newest state is
//! extrapolated at constant velocity from its arrival on. The delay of its messages is unknown, because strangers
//! exchange no heartbeats: its position is uncertain by the distance that it flies in 0.4 s, and by more
//! the longer it is silent. A stranger that has been silent for 10 s has left the cells around, or flown away.
//!
//! All vehicles of a simulated team share the records of what they receive ([`StrangerRecords`]). Most strangers are far away:
//! those that may come within reach soon are looked up when there is a new state, at least every 0.5 s, and a frame
//! extrapolates only them.

mod records;

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::{FleetVehicle, VehicleId};
use skein_common::message::MessageOrder;
use skein_common::time::LocalTime;

use crate::skew::StepClock;
pub(crate) use records::ArrivalAt;
pub use records::StrangerRecords;

/// Largest delay of a stranger's state that its uncertainty covers, s.
const UNKNOWN_DELAY_S: f64 = 0.4;
/// Growth of a silent stranger's uncertainty, m/s, and its limit, m.
const GROWTH_M_S: f64 = 1.0;
const GROWTH_M: f64 = 12.0;
/// Time without a state after which a stranger is forgotten, s.
const FORGOTTEN_S: f64 = 10.0;

/// Time between two searches for the strangers that may be within reach, s.
const LOOK_UP_S: f64 = 0.5;
/// Speed up to which strangers are cleared in time, and below which every vehicle flies, m/s.
pub(crate) const FASTEST_M_S: f64 = 20.0;
/// Distance by which own vehicle and stranger may come nearer in that time, m.
const SKIN_M: f64 = 2.0 * FASTEST_M_S * LOOK_UP_S;

/// A state of a stranger as received.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct StrangerState {
    /// The vehicle that sent it.
    pub id: FleetVehicle,
    /// Its place among the states of this vehicle.
    pub order: MessageOrder,
    /// Position in the own team's frame.
    pub position: PositionNed,
    /// Velocity over the ground.
    pub velocity: VelocityNed,
    /// Time of arrival by the own clock.
    pub at: LocalTime,
}

/// The strangers that a vehicle knows in one step.
#[derive(Clone, Copy, Debug)]
pub struct KnownStrangers<'a> {
    /// The states that the vehicles of its team have received.
    pub records: &'a StrangerRecords,
    /// The correct time, by which they have arrived.
    pub right: LocalTime,
    /// The vehicle's clock in this step.
    pub clock: StepClock,
}

/// A stranger as the safety filter needs it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MovingObstacle {
    /// The vehicle.
    pub id: FleetVehicle,
    /// Its position, extrapolated to now.
    pub position: PositionNed,
    /// Its velocity as last received.
    pub velocity: VelocityNed,
    /// Uncertainty of the position, m.
    pub uncertainty_m: f64,
}

/// The strangers stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Strangers {
    own: VehicleId,
    /// The last search for strangers that may be within reach, and those that it found.
    search: Option<Search>,
    found: Vec<FleetVehicle>,
}

/// The time, place and reach of a search for strangers.
#[derive(Clone, Copy, Debug)]
struct Search {
    at: LocalTime,
    own: PositionNed,
    reach_m: f64,
    /// Revision of the records that were searched.
    revision: u64,
}

impl Search {
    /// Whether this stranger may come within reach before the next search.
    fn finds(&self, known: &StrangerState) -> bool {
        let stranger = known.at_time(self.at);
        let reach_m = self.reach_m + stranger.uncertainty_m + SKIN_M;
        (stranger.position - self.own).xy().norm_squared() <= reach_m * reach_m
    }
}

impl KnownStrangers<'_> {
    /// The newest state that this vehicle has of a stranger, with its time of arrival by the vehicle's clock.
    fn newest(&self, id: FleetVehicle, own: VehicleId) -> Option<StrangerState> {
        self.records.newest(id, own, self.right).map(|state| self.by_own_clock(state))
    }

    fn by_own_clock(&self, state: StrangerState) -> StrangerState {
        StrangerState { at: self.clock.at(state.at), ..state }
    }
}

impl StrangerState {
    /// Distance from which it may still come within `reach_m` of a vehicle before that vehicle forgets it, m, if it arrives up
    /// to `late_s` from now.
    pub(crate) fn matters_within_m(&self, reach_m: f64, late_s: f64) -> f64 {
        let forgotten = self.at_time(self.at.plus_seconds(FORGOTTEN_S));
        let it_moves_m = (forgotten.position - self.position).xy().norm();
        reach_m + forgotten.uncertainty_m + it_moves_m + FASTEST_M_S * (late_s + FORGOTTEN_S)
    }

    /// The stranger at this time, by its last state.
    fn at_time(&self, now: LocalTime) -> MovingObstacle {
        let silent_s = now.seconds_since(self.at).max(0.0);
        let delayed_m = UNKNOWN_DELAY_S * self.velocity.horizontal().norm();
        MovingObstacle {
            id: self.id,
            position: self.position + self.velocity.0 * silent_s,
            velocity: self.velocity,
            uncertainty_m: delayed_m + (GROWTH_M_S * silent_s).min(GROWTH_M),
        }
    }
}

impl Strangers {
    /// The strangers stage of vehicle `own`, before its first search.
    pub fn new(own: VehicleId) -> Self {
        Self { own, search: None, found: Vec::new() }
    }

    /// The strangers within `reach_m` of a position, horizontally, by team and id. `now` is the time by the own clock.
    pub fn near(
        &mut self,
        now: LocalTime,
        known: Option<KnownStrangers<'_>>,
        (own, reach_m): (PositionNed, f64),
    ) -> impl Iterator<Item = MovingObstacle> {
        if let Some(known) = known {
            self.look_up(now, &known, (own, reach_m));
        }
        let Self { own: receiver, found, .. } = self;
        let newest = move |id: &FleetVehicle| known.and_then(|known| known.newest(*id, *receiver));
        let strangers = found.iter().filter_map(newest);
        let is_known = move |state: &StrangerState| now.seconds_since(state.at) < FORGOTTEN_S;
        strangers.filter(is_known).map(move |state| state.at_time(now)).filter(move |stranger| {
            let reach_m = reach_m + stranger.uncertainty_m;
            (stranger.position - own).xy().norm_squared() <= reach_m * reach_m
        })
    }

    /// Searches for the strangers that may come within reach soon. A search counts for 0.5 s, or until there is a new state.
    fn look_up(&mut self, now: LocalTime, known: &KnownStrangers<'_>, (own, reach_m): (PositionNed, f64)) {
        let revision = known.records.revision;
        let is_valid = |search: &Search| {
            let is_new = now >= search.at && now.seconds_since(search.at) < LOOK_UP_S;
            is_new && search.reach_m >= reach_m && search.revision == revision
        };
        if self.search.as_ref().is_some_and(is_valid) {
            return;
        }
        let search = Search { at: now, own, reach_m, revision };
        let finds = |state| search.finds(&known.by_own_clock(state));
        self.found.clear();
        self.found.extend(known.records.with((self.own, known.right), finds));
        self.search = Some(search);
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::String;

    use proptest::prelude::*;
    use skein_common::id::Incarnation;

    use super::*;

    fn own() -> VehicleId {
        VehicleId::new(1).unwrap()
    }

    /// A vehicle with the states that it has received.
    struct Receiver {
        strangers: Strangers,
        records: StrangerRecords,
    }

    impl Receiver {
        fn new() -> Self {
            Self { strangers: Strangers::new(own()), records: StrangerRecords::default() }
        }

        fn receive(&mut self, received: &[StrangerState]) {
            for state in received {
                let arrival = ArrivalAt { at: state.at, receivers: [own()].into_iter().collect() };
                self.records.add(state, state.at, &[arrival], true);
            }
        }

        fn near(&mut self, now: LocalTime, own: PositionNed, reach_m: f64) -> Vec<MovingObstacle> {
            let known = KnownStrangers { records: &self.records, right: now, clock: StepClock::default() };
            self.strangers.near(now, Some(known), (own, reach_m)).collect()
        }

        fn shown(&mut self, now_s: f64, reach_m: f64) -> Vec<(String, f64, f64)> {
            let near = self.near(LocalTime::from_seconds(now_s), PositionNed::new(0.0, 0.0, -30.0), reach_m);
            let shown = |it: &MovingObstacle| (alloc::format!("{}", it.id), it.position.north_m(), it.uncertainty_m);
            near.iter().map(shown).collect()
        }
    }

    fn state(name: &str, sequence: u64, north_m: f64, at_s: f64) -> StrangerState {
        StrangerState {
            id: name.parse().unwrap(),
            order: MessageOrder { incarnation: Incarnation(1), sequence },
            position: PositionNed::new(north_m, 0.0, -30.0),
            velocity: VelocityNed::new(4.0, 0.0, 0.0),
            at: LocalTime::from_seconds(at_s),
        }
    }

    #[test]
    fn a_stranger_is_extrapolated_and_grows_uncertain_until_it_is_forgotten() {
        let mut receiver = Receiver::new();
        receiver.receive(&[state("2/1", 5, 10.0, 1.0)]);
        assert_eq!(receiver.shown(1.0, 100.0), [("2/1".into(), 10.0, 1.6)]);
        assert_eq!(receiver.shown(3.0, 100.0), [("2/1".into(), 18.0, 3.6)]);
        assert_eq!(receiver.shown(10.9, 100.0).len(), 1);
        assert_eq!(receiver.shown(11.1, 100.0), []);
        receiver.records.forget_silent(LocalTime::from_seconds(11.1));
        assert_eq!(receiver.records.len(), 1);
        receiver.records.forget_silent(LocalTime::from_seconds(21.1));
        assert_eq!(receiver.records.len(), 0);
    }

    #[test]
    fn only_a_newer_state_replaces_the_last_one() {
        let mut receiver = Receiver::new();
        receiver.receive(&[state("2/1", 5, 10.0, 1.0), state("2/1", 4, 90.0, 1.0), state("2/1", 5, 90.0, 1.0)]);
        assert_eq!(receiver.shown(1.0, 100.0)[0].1, 10.0);
        let restarted = MessageOrder { incarnation: Incarnation(2), sequence: 1 };
        receiver.receive(&[StrangerState { order: restarted, ..state("2/1", 0, 20.0, 1.0) }]);
        assert_eq!(receiver.shown(1.0, 100.0)[0].1, 20.0);
    }

    #[test]
    fn only_those_that_may_be_within_reach_are_near() {
        let mut receiver = Receiver::new();
        receiver.receive(&[state("9/3", 1, 60.0, 1.0), state("2/7", 1, -61.0, 1.0), state("2/4", 1, 62.0, 1.0)]);
        let names: Vec<_> = receiver.shown(1.0, 60.0).into_iter().map(|(name, ..)| name).collect();
        assert_eq!(names, ["2/7", "9/3"], "61 m are within 60 m and its uncertainty of 1.6 m");
    }

    proptest! {
        #[test]
        fn the_search_finds_whom_a_look_at_all_finds(
            states in proptest::collection::vec((0_u16..6, 0..1500_u64, -300.0..300.0, -300.0..300.0, -14.0..14.0, -14.0..14.0), 1..60),
            own_m_s in (-14.0..14.0, -14.0..14.0), reach_m in 20.0..150.0,
        ) {
            let mut states: Vec<_> = states.into_iter().map(|(team, frame, north_m, east_m, north_m_s, east_m_s)| {
                let id = alloc::format!("{}/1", team + 2).parse().unwrap();
                let order = MessageOrder { incarnation: Incarnation(1), sequence: frame };
                let position = PositionNed::new(north_m, east_m, -30.0);
                let velocity = VelocityNed::new(north_m_s, east_m_s, 0.0);
                (frame, StrangerState { id, order, position, velocity, at: LocalTime::ZERO })
            }).collect();
            states.sort_by_key(|(frame, _)| *frame);
            let (mut receiver, mut all) = (Receiver::new(), Vec::<StrangerState>::new());
            for frame in 0..1500 {
                let now = LocalTime::from_seconds(0.02 * f64::from(frame));
                let own = PositionNed::new(own_m_s.0 * now.seconds(), own_m_s.1 * now.seconds(), -30.0);
                let arrived = states.iter().filter(|(at, _)| *at == u64::from(frame as u32));
                let received: Vec<_> = arrived.map(|(_, state)| StrangerState { at: now, ..*state }).collect();
                receiver.receive(&received);
                for state in received {
                    let newer = |known: &StrangerState| known.id == state.id && known.order >= state.order;
                    if !all.iter().any(newer) {
                        all.retain(|known| known.id != state.id);
                        all.push(state);
                    }
                }
                let found: Vec<_> = receiver.near(now, own, reach_m).iter().map(|stranger| stranger.id).collect();
                let within = |state: &&StrangerState| {
                    let it = state.at_time(now);
                    now.seconds_since(state.at) < FORGOTTEN_S
                        && (it.position - own).xy().norm_squared() <= skein_common::math::square(reach_m + it.uncertainty_m)
                };
                let mut near: Vec<_> = all.iter().filter(within).map(|state| state.id).collect();
                near.sort();
                prop_assert_eq!(found, near);
            }
        }
    }
}
