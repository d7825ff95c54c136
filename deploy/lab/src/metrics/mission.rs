//! Measures how the swarm moves from step to step of its mission.

use super::{VehicleNow, index};

/// The mission steps of the live members.
#[derive(Debug)]
pub(super) struct Steps {
    /// Number of steps that every live member has reached or passed; `None` before the first vehicle was a member.
    pub(super) passed: Option<u32>,
    /// Time at which the last live member reached or passed each step, s. Unknown for steps that were open when the
    /// window began.
    open_s: Vec<Option<f64>>,
    /// The step of each vehicle at the last observation as a live member, by id.
    at: Vec<Option<u32>>,
    /// The largest difference of two live members' steps.
    pub(super) skew: Option<u32>,
    /// Longest time from when every live member had reached a step until a member left it, s.
    pub(super) latency_s: Option<f64>,
}

impl Steps {
    /// A mission of `steps` steps, flown by `vehicles` vehicles, before the first observation.
    pub(super) fn new(steps: usize, vehicles: usize) -> Self {
        Self { passed: None, open_s: vec![None; steps], at: vec![None; vehicles], skew: None, latency_s: None }
    }

    pub(super) fn observe(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        self.open(t_s, vehicles);
        for vehicle in vehicles {
            let Some(at) = self.at.get_mut(index(vehicle.id)) else { continue };
            let before = std::mem::replace(at, vehicle.is_live_member().then_some(vehicle.step));
            // A vehicle that begins to land is not a member any more, but it has still entered the landing step.
            let has_entered = vehicle.runs && before.is_some_and(|before| vehicle.step > before);
            let left = vehicle.step.checked_sub(1).filter(|_| has_entered);
            if let Some(open_s) = left.and_then(|left| *self.open_s.get(left as usize)?) {
                self.latency_s = Some(self.latency_s.unwrap_or(0.0).max(t_s - open_s));
            }
        }
    }

    /// Notes the steps that every live member has now reached or passed.
    fn open(&mut self, t_s: f64, vehicles: &[VehicleNow]) {
        let members = || vehicles.iter().filter(|vehicle| vehicle.is_live_member());
        // Where the last members have begun to land between two observations, they still have entered the landing step.
        let before = |vehicle: &VehicleNow| self.at.get(index(vehicle.id)).copied().flatten();
        let has_entered =
            |vehicle: &&VehicleNow| vehicle.runs && before(vehicle).is_some_and(|before| vehicle.step > before);
        let passed = |vehicle: &VehicleNow| vehicle.reached.map_or(0, |reached| reached + 1).max(vehicle.step);
        let by_landing = || vehicles.iter().filter(has_entered).map(passed).min();
        let Some(passed) = members().map(passed).min().or_else(by_landing) else { return };
        let steps = members().map(|member| member.step);
        if let (Some(least), Some(most)) = (steps.clone().min(), steps.max()) {
            self.skew = self.skew.max(Some(most - least));
        }
        if let Some(before) = self.passed {
            for step in before..passed {
                if let Some(open_s) = self.open_s.get_mut(step as usize) {
                    *open_s = Some(t_s);
                }
            }
        }
        self.passed = Some(passed);
    }
}

#[cfg(test)]
mod tests {
    use skein_common::state::Membership;

    use super::super::tests::vehicle;
    use super::*;

    /// Vehicle `number` at a step, with the highest step that it has reached.
    fn at(number: u8, step: u32, reached: Option<u32>) -> VehicleNow {
        VehicleNow { step, reached, ..vehicle(number, 0.0, 100.0, 30.0) }
    }

    fn observed(history: &[(f64, &[VehicleNow])]) -> Steps {
        let mut steps = Steps::new(4, 3);
        history.iter().for_each(|(t_s, vehicles)| steps.observe(*t_s, vehicles));
        steps
    }

    #[test]
    fn latency_is_from_the_last_reach_to_the_last_entry() {
        let steps = observed(&[
            (0.0, &[at(1, 0, None), at(2, 0, None)]),
            (10.0, &[at(1, 0, Some(0)), at(2, 0, None)]),
            (14.0, &[at(1, 0, Some(0)), at(2, 0, Some(0))]),
            (14.2, &[at(1, 1, Some(0)), at(2, 0, Some(0))]),
            (14.5, &[at(1, 1, Some(0)), at(2, 1, Some(0))]),
            (30.0, &[at(1, 1, Some(1)), at(2, 1, Some(1))]),
            (30.1, &[at(1, 2, Some(1)), at(2, 2, Some(1))]),
        ]);
        assert!((steps.latency_s.unwrap() - 0.5).abs() < 1e-9, "{:?}", steps.latency_s);
        assert_eq!((steps.passed, steps.skew), (Some(2), Some(1)));
    }

    #[test]
    fn the_death_of_the_last_missing_member_opens_the_step() {
        let dead = VehicleNow { runs: false, ..at(2, 0, None) };
        let steps = observed(&[
            (0.0, &[at(1, 0, Some(0)), at(2, 0, None)]),
            (20.0, &[at(1, 0, Some(0)), dead]),
            (20.5, &[at(1, 1, Some(0)), dead]),
        ]);
        assert!((steps.latency_s.unwrap() - 0.5).abs() < 1e-9, "since the death: {:?}", steps.latency_s);
        assert_eq!((steps.passed, steps.skew), (Some(1), Some(0)));
    }

    #[test]
    fn a_vehicle_that_is_carried_forward_adds_to_the_skew_but_not_to_the_latency() {
        let steps = observed(&[
            (0.0, &[at(1, 0, Some(0)), at(2, 0, None)]),
            (5.0, &[at(1, 1, Some(1)), at(2, 0, None)]),
            (20.0, &[at(1, 2, Some(1)), at(2, 0, None)]),
            (30.0, &[at(1, 2, Some(1)), at(2, 2, None)]),
        ]);
        assert_eq!((steps.passed, steps.skew, steps.latency_s), (Some(2), Some(2), Some(0.0)));
    }

    #[test]
    fn joining_adds_no_latency_and_a_landing_counts_as_entering_its_step() {
        let joining = |step| VehicleNow { membership: Membership::Joining, ..at(3, step, None) };
        let landing = VehicleNow { membership: Membership::Left, ..at(1, 3, Some(2)) };
        let steps = observed(&[
            (0.0, &[at(1, 2, None), joining(0)]),
            (10.0, &[at(1, 2, Some(2)), joining(0)]),
            (11.0, &[at(1, 2, Some(2)), joining(2)]),
            (12.0, &[landing, joining(2)]),
        ]);
        assert_eq!((steps.passed, steps.skew, steps.latency_s), (Some(3), Some(0), Some(2.0)));
    }

    #[test]
    fn a_step_is_passed_by_members_that_begin_to_land_between_two_observations() {
        let landing = |number| VehicleNow { membership: Membership::Left, ..at(number, 1, Some(0)) };
        let steps = observed(&[(0.0, &[at(1, 0, None), at(2, 0, None)]), (0.1, &[landing(1), landing(2)])]);
        assert_eq!(steps.passed, Some(1));
        let steps = observed(&[(0.0, &[at(1, 0, None), at(2, 0, None)]), (0.1, &[landing(1), at(2, 0, None)])]);
        assert_eq!(steps.passed, Some(0), "vehicle 2 is still there");
    }
}
