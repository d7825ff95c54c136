//! The rate at which the steps of a flight are recorded or shown.

use std::collections::BTreeMap;

use skein_common::id::VehicleId;
use skein_common::message::Trace;

/// Limits the steps recorded a second, by the simulator's clock, so that a delayed queue loses no steps.
#[derive(Debug)]
pub struct Rate {
    period_s: f64,
    /// Each vehicle's last time and the time when its next step is due, s of its simulator's clock.
    due_s: BTreeMap<VehicleId, (f64, f64)>,
}

impl Rate {
    /// At most so many steps a second, Hz.
    pub fn new(hz: f64) -> Self {
        Self { period_s: 1.0 / hz, due_s: BTreeMap::new() }
    }

    /// Whether this step is to be recorded. Answers once for each step.
    pub fn is_due(&mut self, trace: &Trace) -> bool {
        let t_s = trace.plant_time.seconds();
        let (last_s, due_s) = self.due_s.get(&trace.header.sender).copied().unwrap_or((t_s, t_s));
        // A restarted simulator has a restarted clock.
        let due_s = if t_s < last_s { t_s } else { due_s };
        // Frame times are irregular: record the frame nearest to the deadline, assuming that the next frame takes as
        // long as this one.
        let frame_s = (t_s - last_s).max(0.0);
        let is_due = t_s >= due_s - 0.5 * frame_s;
        let next_s = if is_due { (due_s + self.period_s).max(t_s + 0.5 * self.period_s) } else { due_s };
        self.due_s.insert(trace.header.sender, (t_s, next_s));
        is_due
    }
}

#[cfg(test)]
mod tests {
    use skein_common::time::PlantTime;
    use skein_lab::scenario::ScenarioArgs;
    use skein_lab::world::World;

    use super::*;

    /// Number of steps recorded in 10 s of frames every `frame_s`; halfway through, the simulator's clock jumps back.
    fn recorded_steps(hz: f64, frame_s: f64) -> usize {
        let mut rate = Rate::new(hz);
        let args = ScenarioArgs::default();
        let scenario = args.read(Vec::new()).unwrap().scenario;
        let ready = args.ready(&scenario).unwrap();
        let mut world = World::new(&scenario, &ready.aircraft, &ready.rules).unwrap();
        world.tick();
        let mut step = world.traces().next().unwrap();
        let frames = (10.0 / frame_s).round() as usize;
        let mut is_due = |nth: usize| {
            let t_s = if nth < frames / 2 { 100.0 + nth as f64 * frame_s } else { nth as f64 * frame_s };
            step.plant_time = PlantTime::from_seconds(t_s);
            rate.is_due(&step)
        };
        (0..frames).filter(|nth| is_due(*nth)).count()
    }

    #[test]
    fn the_recording_rate_holds_at_any_frame_rate() {
        assert_eq!(recorded_steps(50.0, 0.02), 500, "every one");
        assert_eq!(recorded_steps(10.0, 0.02), 100);
        assert_eq!(recorded_steps(50.0, 0.01), 500);
        assert_eq!(recorded_steps(1000.0, 0.02), 500, "no more than there are");
        let uneven = recorded_steps(50.0, 1.0 / 60.0);
        assert!((480..=510).contains(&uneven), "{uneven}");
    }
}
