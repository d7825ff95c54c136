//! The strangers stage: the vehicles of other teams that share the air.
//!
//! Across the teams of a fleet only states travel. A stranger's mission and law are unknown, and it may know nothing of
//! this vehicle: it is an obstacle that moves, and the safety filter keeps clear of it alone. Its newest state is
//! extrapolated at constant velocity from its arrival on. The delay of its messages is unknown, because strangers
//! exchange no heartbeats: its position is uncertain by the distance that it flies in 0.4 s, and by more
//! the longer it is silent. A stranger that has been silent for 10 s has left the cells around, or flown away.
//!
//! Most strangers are far away. Those that may come within reach soon are looked up every 0.5 s, and a frame
//! extrapolates only them.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::FleetVehicle;
use skein_common::message::MessageOrder;
use skein_common::time::LocalTime;

/// Largest delay of a stranger's state that its uncertainty covers, s.
const UNKNOWN_DELAY_S: f64 = 0.4;
/// Growth of a silent stranger's uncertainty, m/s, and its limit, m.
const GROWTH_M_S: f64 = 1.0;
const GROWTH_M: f64 = 12.0;
/// Time without a state after which a stranger is forgotten, s.
const FORGOTTEN_S: f64 = 10.0;

/// Time between two searches for the strangers that may be within reach, s.
const LOOK_UP_S: f64 = 0.5;
/// Distance by which own vehicle and stranger may come nearer in that time, m: each flies less than 20 m/s.
const SKIN_M: f64 = 2.0 * 20.0 * LOOK_UP_S;

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

/// The states of strangers that one step takes.
#[derive(Clone, Copy, Debug, Default)]
pub struct StrangersReceived<'a> {
    /// Those that the network impaired, each with its time of arrival by the own clock.
    pub stamped: &'a [StrangerState],
    /// Those that arrived since the last step; their [`StrangerState::at`] has no meaning.
    pub now: &'a [StrangerState],
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
#[derive(Clone, Debug, Default)]
pub struct Strangers {
    /// The strangers, in order.
    ids: Vec<FleetVehicle>,
    /// The newest state of each.
    known: Vec<StrangerState>,
    now: LocalTime,
    /// The last search for strangers that may be within reach; `None` if it has to be repeated.
    search: Option<Search>,
    /// Indices of the strangers that the search found.
    found: Vec<usize>,
    /// Number of states dropped because a newer one had been received.
    old: u64,
}

/// Where and when strangers were searched.
#[derive(Clone, Copy, Debug)]
struct Search {
    at: LocalTime,
    own: PositionNed,
    reach_m: f64,
}

impl Search {
    /// Whether this stranger may come within reach before the next search.
    fn finds(&self, known: &StrangerState) -> bool {
        let stranger = known.at_time(self.at);
        let reach_m = self.reach_m + stranger.uncertainty_m + SKIN_M;
        (stranger.position - self.own).xy().norm_squared() <= reach_m * reach_m
    }
}

impl StrangerState {
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
    /// Takes the states received since the last update.
    pub fn update(&mut self, now: LocalTime, received: StrangersReceived<'_>) {
        self.now = now;
        received.stamped.iter().for_each(|state| self.take(state, state.at.min(now)));
        received.now.iter().for_each(|state| self.take(state, now));
    }

    fn take(&mut self, state: &StrangerState, at: LocalTime) {
        match self.ids.binary_search(&state.id) {
            Err(place) => {
                self.ids.insert(place, state.id);
                self.known.insert(place, StrangerState { at, ..*state });
                self.search = None;
            }
            Ok(place) if self.known[place].order < state.order => {
                let state = StrangerState { at, ..*state };
                self.known[place] = state;
                let is_new = |search: &Search| search.finds(&state) && !self.found.contains(&place);
                self.search = self.search.filter(|search| !is_new(search));
            }
            Ok(_) => self.old += 1,
        }
    }

    /// The strangers that may be within `reach_m` of a position, horizontally, by team and id.
    pub fn near(&mut self, own: PositionNed, reach_m: f64) -> impl Iterator<Item = MovingObstacle> {
        let is_valid = |search: Search| {
            self.now.seconds_since(search.at) < LOOK_UP_S && search.reach_m >= reach_m && self.now >= search.at
        };
        if !self.search.is_some_and(is_valid) {
            self.search(own, reach_m);
        }
        let strangers = self.found.iter().map(|&place| self.known[place].at_time(self.now));
        strangers.filter(move |stranger| {
            let reach_m = reach_m + stranger.uncertainty_m;
            (stranger.position - own).xy().norm_squared() <= reach_m * reach_m
        })
    }

    /// Searches for the strangers that may come within reach soon, and forgets those that have been silent for long.
    fn search(&mut self, own: PositionNed, reach_m: f64) {
        let search = Search { at: self.now, own, reach_m };
        let is_known = |known: &StrangerState| search.at.seconds_since(known.at) < FORGOTTEN_S;
        if !self.known.iter().all(is_known) {
            self.known.retain(is_known);
            self.ids.clear();
            self.ids.extend(self.known.iter().map(|known| known.id));
        }
        self.found.clear();
        self.found.extend((0..self.known.len()).filter(|&place| search.finds(&self.known[place])));
        self.search = Some(search);
    }

    /// Number of strangers known.
    pub fn len(&self) -> usize {
        self.known.len()
    }

    /// Whether no stranger is known.
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// Number of states dropped because a newer one had been received.
    pub fn old(&self) -> u64 {
        self.old
    }
}

#[cfg(test)]
mod tests {
    use alloc::string::String;

    use proptest::prelude::*;
    use skein_common::id::Incarnation;

    use super::*;

    fn state(name: &str, sequence: u64, north_m: f64, at_s: f64) -> StrangerState {
        StrangerState {
            id: name.parse().unwrap(),
            order: MessageOrder { incarnation: Incarnation(1), sequence },
            position: PositionNed::new(north_m, 0.0, -30.0),
            velocity: VelocityNed::new(4.0, 0.0, 0.0),
            at: LocalTime::from_seconds(at_s),
        }
    }

    fn update(strangers: &mut Strangers, now_s: f64, received: &[StrangerState]) {
        strangers.update(LocalTime::from_seconds(now_s), StrangersReceived { stamped: received, now: &[] });
    }

    fn near(strangers: &mut Strangers, reach_m: f64) -> Vec<(String, f64, f64)> {
        let shown = |it: MovingObstacle| (alloc::format!("{}", it.id), it.position.north_m(), it.uncertainty_m);
        strangers.near(PositionNed::new(0.0, 0.0, -30.0), reach_m).map(shown).collect()
    }

    #[test]
    fn a_stranger_is_extrapolated_and_grows_uncertain_until_it_is_forgotten() {
        let mut strangers = Strangers::default();
        update(&mut strangers, 1.0, &[state("2/1", 5, 10.0, 1.0)]);
        assert_eq!(near(&mut strangers, 100.0), [("2/1".into(), 10.0, 1.6)]);
        update(&mut strangers, 3.0, &[]);
        assert_eq!(near(&mut strangers, 100.0), [("2/1".into(), 18.0, 3.6)]);
        update(&mut strangers, 11.5, &[]);
        assert_eq!(near(&mut strangers, 100.0), []);
        assert!(strangers.is_empty());
    }

    #[test]
    fn only_a_newer_state_replaces_the_last_one() {
        let mut strangers = Strangers::default();
        let received = [state("2/1", 5, 10.0, 1.0), state("2/1", 4, 90.0, 1.0), state("2/1", 5, 90.0, 1.0)];
        update(&mut strangers, 1.0, &received);
        assert_eq!((near(&mut strangers, 100.0)[0].1, strangers.old()), (10.0, 2));
        let restarted = MessageOrder { incarnation: Incarnation(2), sequence: 1 };
        update(&mut strangers, 1.0, &[StrangerState { order: restarted, ..state("2/1", 0, 20.0, 1.0) }]);
        assert_eq!(near(&mut strangers, 100.0)[0].1, 20.0);
    }

    #[test]
    fn only_those_that_may_be_within_reach_are_near() {
        let mut strangers = Strangers::default();
        let received = [state("9/3", 1, 60.0, 1.0), state("2/7", 1, -61.0, 1.0), state("2/4", 1, 62.0, 1.0)];
        update(&mut strangers, 1.0, &received);
        let names: Vec<_> = near(&mut strangers, 60.0).into_iter().map(|(name, ..)| name).collect();
        assert_eq!(names, ["2/7", "9/3"], "61 m are within 60 m and its uncertainty of 1.6 m");
        assert_eq!(strangers.len(), 3);
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
            let (mut strangers, mut all) = (Strangers::default(), Vec::<StrangerState>::new());
            for frame in 0..1500 {
                let now = LocalTime::from_seconds(0.02 * f64::from(frame));
                let own = PositionNed::new(own_m_s.0 * now.seconds(), own_m_s.1 * now.seconds(), -30.0);
                let arrived = states.iter().filter(|(at, _)| *at == u64::from(frame as u32));
                let received: Vec<_> = arrived.map(|(_, state)| StrangerState { at: now, ..*state }).collect();
                let (half, rest) = received.split_at(received.len() / 2);
                strangers.update(now, StrangersReceived { stamped: half, now: rest });
                for state in received {
                    let newer = |known: &StrangerState| known.id == state.id && known.order >= state.order;
                    if !all.iter().any(newer) {
                        all.retain(|known| known.id != state.id);
                        all.push(state);
                    }
                }
                let found: Vec<_> = strangers.near(own, reach_m).collect();
                let within = |state: &StrangerState| {
                    let it = state.at_time(now);
                    (it.position - own).xy().norm() <= reach_m + it.uncertainty_m
                };
                let silent_s = |state: &StrangerState| now.seconds_since(state.at);
                let near_ones = |longest_s: f64| all.iter().filter(|it| silent_s(it) < longest_s && within(it)).count();
                prop_assert!(found.len() >= near_ones(FORGOTTEN_S) && found.len() <= near_ones(FORGOTTEN_S + LOOK_UP_S));
            }
        }
    }
}
