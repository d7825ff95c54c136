//! Whether a vehicle that has not reached its step still comes nearer to it.
//!
//! The others wait for every active member that has not reached the step. So that no member keeps them waiting for ever, one
//! that has come no nearer for `mission.progress_timeout_s` leaves and lands ([`Deadline::NoProgress`]).
//!
//! Nearer is what a law, wind and avoidance leave a vehicle to do: any of the [`Remaining`] amounts has to fall below its least
//! value within the step. Each cannot fall below zero, and counts only when it has fallen by a stated amount: so a vehicle
//! that never reaches its step stops coming nearer at last, whatever it does.
//!
//! A vehicle that flies as its law commands is not the one that keeps the others waiting: in a crowded ring all of them move
//! along it for minutes, and none comes nearer. Its time counts a tenth, so that it leaves at last too.

use alloc::vec::Vec;

use skein_common::message::{EventKind, Failure};
use skein_common::state::Membership;
use skein_common::time::PlantTime;

use super::{AT_ALTITUDE_M, Mission, STUCK_M_S, View};
use crate::deadlines::Deadline;
use crate::estimate::Estimate;

/// Fall of a remaining distance or time that counts, m or s: above the wander of a hover in gusts, far below what a vehicle
/// flies in a minute.
const NEARER: f64 = 0.5;
/// Factor by which the time without coming nearer may be longer while a vehicle flies as its law commands.
const PATIENCE: f64 = 10.0;

/// The distances and times that remain until the vehicle has reached its step. Each is at least 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Remaining {
    /// Distance from the formation's centre, m.
    pub(super) to_centre_m: f64,
    /// The position error that the formation commands away, m.
    pub(super) error_m: f64,
    /// The altitude error, m.
    pub(super) altitude_error_m: f64,
    /// The centre's way along its path, m.
    pub(super) path_m: f64,
    /// Time for which the vehicle has to be in place, s.
    pub(super) dwell_s: f64,
}

impl Remaining {
    fn amounts(self) -> [f64; 5] {
        let Self { to_centre_m, error_m, altitude_error_m, path_m, dwell_s } = self;
        [to_centre_m, error_m, altitude_error_m, path_m, dwell_s]
    }
}

/// The approach of a vehicle to its step.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Approach {
    /// The least of each remaining amount that has counted in this step; `None` before the first.
    least: Option<[f64; 5]>,
    /// Time for which none of them has fallen, s.
    idle_s: f64,
}

impl Approach {
    /// Counts `dt_s` in which the vehicle was to come nearer, and after which this remains. It `follows` if it flies as its law
    /// commands.
    pub(super) fn update(&mut self, dt_s: f64, remaining: Remaining, follows: bool) {
        let now = remaining.amounts();
        let Some(least) = &mut self.least else {
            *self = Self { least: Some(now), idle_s: 0.0 };
            return;
        };
        self.idle_s += if follows { dt_s / PATIENCE } else { dt_s };
        for (least, now) in least.iter_mut().zip(now) {
            if now <= *least - NEARER {
                (*least, self.idle_s) = (now, 0.0);
            }
        }
    }

    /// Begins to count again: the step, the place in it or the members have changed.
    pub(super) fn restart(&mut self) {
        *self = Self::default();
    }

    /// Whether the vehicle has come no nearer for this time, s.
    pub(super) fn has_stopped(&self, timeout_s: f64) -> bool {
        Deadline::NoProgress(timeout_s).is_past(self.idle_s)
    }
}

impl Mission {
    /// Watches whether the vehicle comes nearer to a step that it has to reach, so that the others can leave it.
    pub(super) fn watch_approach(
        &mut self,
        dt_s: f64,
        estimate: &Estimate,
        view: &View,
        happened: &mut Vec<EventKind>,
    ) {
        let has_next = self.at() as usize + 1 < self.legs.len();
        let place = self.leg().filter(|leg| has_next && leg.needs_place());
        let (Some(leg), Some(error_m), Some(altitude_error_m)) = (place, view.error_m, view.altitude_error_m) else {
            return;
        };
        if self.is_complete {
            return;
        }
        let (path_m, dwell_s) = self.progress.remaining(leg);
        let (centre_ne_m, _) = self.progress.centre(leg);
        let to_centre_m = (estimate.position.horizontal() - centre_ne_m).norm();
        let nearing_m_s = -estimate.velocity.down_m_s() * altitude_error_m.signum();
        let altitude_error_m = altitude_error_m.abs();
        let follows = view.follows_law && (altitude_error_m < AT_ALTITUDE_M || nearing_m_s >= STUCK_M_S);
        let remaining = Remaining { to_centre_m, error_m, altitude_error_m, path_m, dwell_s };
        self.approach.update(dt_s, remaining, follows);
        self.gave_up = self.approach.has_stopped(self.progress_timeout_s);
        happened.extend(self.gave_up.then_some(EventKind::Failed(Failure::Place)));
    }

    /// Watches whether a vehicle in the air that could join does so. Otherwise it would hold its position for ever.
    pub(super) fn watch_joining(&mut self, now: PlantTime, could_join: bool, happened: &mut Vec<EventKind>) {
        let is_kept_out = could_join && self.membership() == Membership::Joining;
        let since = self.kept_out_since.take().unwrap_or(now);
        self.kept_out_since = is_kept_out.then_some(since);
        let is_past = Deadline::NoProgress(self.progress_timeout_s).is_past(now.seconds_since(since));
        if is_kept_out && is_past && !self.gave_up {
            self.gave_up = true;
            happened.push(EventKind::Failed(Failure::Place));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const FAR: Remaining =
        Remaining { to_centre_m: 300.0, error_m: 10.0, altitude_error_m: 30.0, path_m: 0.0, dwell_s: 3.0 };

    #[test]
    fn any_amount_that_falls_is_progress_and_a_wandering_one_is_not() {
        let falls: [fn(f64) -> Remaining; 5] = [
            |s| Remaining { to_centre_m: 300.0 - 0.02 * s, ..FAR },
            |s| Remaining { error_m: 10.0 - 0.02 * s, ..FAR },
            |s| Remaining { altitude_error_m: 30.0 - 0.02 * s, ..FAR },
            |s| Remaining { path_m: 300.0 - 0.02 * s, ..FAR },
            |s| Remaining { dwell_s: 300.0 - s, ..FAR },
        ];
        for fall in falls {
            let mut approach = Approach::default();
            for second in 0..300 {
                approach.update(1.0, fall(f64::from(second)), false);
                assert!(!approach.has_stopped(60.0), "{second} s");
            }
        }
        let mut approach = Approach::default();
        for second in 0..60 {
            let wander_m = if second % 2 == 0 { 0.0 } else { 0.4 };
            approach.update(1.0, Remaining { to_centre_m: 300.0 - wander_m, ..FAR }, false);
            assert!(!approach.has_stopped(60.0));
        }
        approach.update(2.0, FAR, false);
        assert!(approach.has_stopped(60.0));
        approach.restart();
        assert!(!approach.has_stopped(60.0));
    }

    #[test]
    fn a_vehicle_that_flies_as_commanded_has_ten_times_as_long() {
        let mut approach = Approach::default();
        let stopped = (0..1000).find(|_| {
            approach.update(1.0, FAR, true);
            approach.has_stopped(60.0)
        });
        assert!(stopped.is_some_and(|second| (600..=602).contains(&second)), "{stopped:?}");
    }

    proptest! {
        #[test]
        fn a_vehicle_that_never_arrives_has_stopped_at_last(amounts in prop::collection::vec(prop::array::uniform5(0.0..5.0f64), 4000)) {
            let mut approach = Approach::default();
            let has_stopped = amounts.into_iter().any(|[to_centre_m, error_m, altitude_error_m, path_m, dwell_s]| {
                approach.update(1.0, Remaining { to_centre_m, error_m, altitude_error_m, path_m, dwell_s }, false);
                approach.has_stopped(60.0)
            });
            // Five amounts fall from 5 at most ten times each, and a minute at most passes before each.
            prop_assert!(has_stopped);
        }
    }
}
