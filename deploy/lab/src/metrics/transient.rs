//! Measures how long the formation takes to settle after a vehicle has joined or left.

use skein_common::id::VehicleSet;

use super::series::{Settling, Worst};

/// Time after which an undisturbed formation that has not settled counts as never settled, s.
const LIMIT_S: f64 = 120.0;

/// The transients of the formation.
///
/// A transient begins when the set of live members changes, or when a cut is healed, and ends with the next such change
/// or cut. Its length is the time after which the formation stayed settled until then. While a link is cut, the swarm
/// has no common formation to settle. A swarm that moves on to another step breaks up its formation: a transient that
/// had settled ends, and one that had not gets a new chance.
#[derive(Clone, Debug, Default)]
pub(super) struct Transients {
    members: Option<VehicleSet>,
    is_split: bool,
    step: Option<u32>,
    current: Option<Transient>,
    worst: Worst,
}

#[derive(Clone, Copy, Debug)]
struct Transient {
    since_s: f64,
    /// Time since which the swarm is at its step, or since which the transient lasts, whichever is later, s.
    calm_since_s: f64,
    settling: Settling,
}

impl Transients {
    /// Observes the live members, whether a link is cut, the highest step of a member, and whether the formation is
    /// settled.
    pub(super) fn observe(
        &mut self,
        t_s: f64,
        members: VehicleSet,
        is_split: bool,
        step: Option<u32>,
        is_settled: bool,
    ) {
        let is_change = self.members.is_some_and(|before| before != members);
        if is_change || is_split != self.is_split {
            self.close(t_s);
            let begins = Transient { since_s: t_s, calm_since_s: t_s, settling: Settling::default() };
            self.current = (!is_split).then_some(begins);
        } else if step != self.step {
            match &mut self.current {
                Some(current) if current.settling.since_s.is_none() => current.calm_since_s = t_s,
                _ => self.close(t_s),
            }
        }
        (self.members, self.is_split, self.step) = (Some(members), is_split, step);
        if let Some(current) = &mut self.current {
            current.settling.observe(t_s, is_settled);
        }
    }

    /// The longest transient of a window that ends at `t_s`.
    pub(super) fn worst(&self, t_s: f64) -> Worst {
        let mut ended = self.clone();
        ended.close(t_s);
        ended.worst
    }

    fn close(&mut self, t_s: f64) {
        let Some(Transient { since_s, calm_since_s, settling }) = self.current.take() else { return };
        match settling.since_s {
            Some(settled_s) => self.worst.add_time(settled_s - since_s),
            None if t_s - calm_since_s > LIMIT_S => self.worst.is_never = true,
            None => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::set;
    use super::*;

    /// The figure of a window of `end_s` seconds, observed once a second.
    fn worst(
        end_s: u32,
        members: impl Fn(u32) -> VehicleSet,
        is_split: impl Fn(u32) -> bool,
        is_settled: impl Fn(u32) -> bool,
    ) -> (Option<f64>, bool) {
        with_steps(end_s, members, is_split, |_| 0, is_settled)
    }

    fn with_steps(
        end_s: u32,
        members: impl Fn(u32) -> VehicleSet,
        is_split: impl Fn(u32) -> bool,
        step: impl Fn(u32) -> u32,
        is_settled: impl Fn(u32) -> bool,
    ) -> (Option<f64>, bool) {
        let mut transients = Transients::default();
        for t_s in 0..=end_s {
            transients.observe(f64::from(t_s), members(t_s), is_split(t_s), Some(step(t_s)), is_settled(t_s));
        }
        let worst = transients.worst(f64::from(end_s));
        (worst.s(), worst.is_never)
    }

    #[test]
    fn without_a_change_there_is_no_transient() {
        assert_eq!(worst(300, |_| set(&[1, 2]), |_| false, |t_s| t_s > 80), (None, false));
    }

    #[test]
    fn a_transient_lasts_until_the_formation_is_settled_for_good() {
        let loses_one = |t_s| if t_s < 100 { set(&[1, 2, 3]) } else { set(&[1, 3]) };
        let figure = worst(300, loses_one, |_| false, |t_s| t_s < 100 || t_s == 120 || t_s >= 140);
        assert_eq!(figure, (Some(40.0), false));
    }

    #[test]
    fn the_next_change_ends_a_transient_and_the_worst_counts() {
        let members = |t_s| match t_s {
            0..50 => set(&[1, 2, 3]),
            50..100 => set(&[1, 3]),
            _ => set(&[1, 2, 3]),
        };
        let settled = |t_s| (80..100).contains(&t_s) || t_s >= 115;
        assert_eq!(worst(300, members, |_| false, settled), (Some(30.0), false));
    }

    #[test]
    fn a_formation_that_has_time_and_does_not_settle_counts_as_never() {
        let members = |t_s| if t_s < 50 { set(&[1, 2]) } else { set(&[1]) };
        assert_eq!(worst(170, members, |_| false, |t_s| t_s < 50), (None, false), "only 120 s were left");
        assert_eq!(worst(171, members, |_| false, |t_s| t_s < 50), (None, true));
    }

    #[test]
    fn a_split_swarm_has_no_transient_and_a_healed_one_has() {
        let split = |t_s| (50..250).contains(&t_s);
        let figure = worst(400, |_| set(&[1, 2, 3, 4]), split, |t_s| !(50..262).contains(&t_s));
        assert_eq!(figure, (Some(12.0), false), "the 200 s of the cut do not count");
    }

    #[test]
    fn a_step_ends_a_settled_transient_and_gives_an_unsettled_one_a_new_chance() {
        let loses_one = |t_s| if t_s < 50 { set(&[1, 2, 3]) } else { set(&[1, 3]) };
        let unsplit = |_| false;
        let step = |t_s| u32::from(t_s >= 100);
        let settled = |t_s| (80..100).contains(&t_s);
        assert_eq!(
            with_steps(400, loses_one, unsplit, step, settled),
            (Some(30.0), false),
            "the formation need not hold on the way"
        );
        let later = |t_s| t_s >= 190;
        assert_eq!(with_steps(400, loses_one, unsplit, step, later), (Some(140.0), false), "at the next place");
        assert_eq!(with_steps(220, loses_one, unsplit, step, |_| false), (None, false), "120 s at the next place");
        assert_eq!(with_steps(221, loses_one, unsplit, step, |_| false), (None, true));
    }
}
