use super::*;
use skein_host::clock::now;

/// A simulator with frames of 20 ms local time, whose own time starts at `running_s`.
struct Simulator {
    start: Instant,
    local_s: f64,
    running_s: f64,
}

impl Simulator {
    fn new(running_s: f64) -> Self {
        Self { start: now(), local_s: 0.0, running_s }
    }

    fn run(&mut self, clock: &mut Clock, seconds: f64, rate: f64) -> Option<PlantTime> {
        let mut last = None;
        for _ in 0..(seconds / 0.02).round() as u32 {
            self.local_s += 0.02;
            self.running_s += 0.02 * rate;
            let at = self.start + Duration::from_secs_f64(self.local_s);
            clock.running_time(at, self.running_s as f32);
            last = clock.frame(at);
        }
        last
    }
}

#[test]
fn the_first_frame_is_at_zero_and_time_passes() {
    let mut clock = Clock::new();
    let end = Simulator::new(0.0).run(&mut clock, 2.0, 1.0).unwrap();
    assert!((end.seconds() - 1.98).abs() < 1e-6, "{end:?}");
}

#[test]
fn a_slow_simulator_slows_time_after_a_second() {
    let (mut clock, mut simulator) = (Clock::new(), Simulator::new(0.0));
    let before = simulator.run(&mut clock, 2.0, 0.5).unwrap();
    let after = simulator.run(&mut clock, 10.0, 0.5).unwrap();
    assert!((clock.rate - 0.5).abs() < 1e-3, "{}", clock.rate);
    assert!((after.seconds_since(before) - 5.0).abs() < 0.01, "{}", after.seconds_since(before));
}

#[test]
fn the_coarse_clock_of_a_simulator_that_ran_for_days_suffices() {
    for running_s in [3600.0, 86_400.0, 3.0 * 86_400.0] {
        let (mut clock, mut simulator) = (Clock::new(), Simulator::new(running_s));
        for _ in 0..50 {
            simulator.run(&mut clock, 1.0, 1.0);
            assert!((clock.rate - 1.0).abs() <= 2.0 * MAX_STEP_SHARE, "{running_s}: {}", clock.rate);
        }
    }
}

#[test]
fn no_time_passes_and_no_frame_comes_in_a_pause() {
    let (mut clock, mut simulator) = (Clock::new(), Simulator::new(0.0));
    let before = simulator.run(&mut clock, 3.0, 1.0).unwrap();
    clock.set_paused(true);
    assert_eq!(simulator.run(&mut clock, 5.0, 0.0), None);
    clock.set_paused(false);
    let after = simulator.run(&mut clock, 3.0, 1.0).unwrap();
    assert!((after.seconds_since(before) - 3.0).abs() < 1e-6, "{}", after.seconds_since(before));
    assert!((clock.rate - 1.0).abs() < 1e-3, "the pause does not affect the measured rate");
}

#[test]
fn a_simulator_that_starts_paused_has_no_frames() {
    let (mut clock, mut simulator) = (Clock::new(), Simulator::new(0.0));
    clock.set_paused(true);
    assert_eq!(simulator.run(&mut clock, 1.0, 0.0), None);
    clock.set_paused(false);
    assert!(simulator.run(&mut clock, 0.02, 1.0).is_some());
}

#[test]
fn a_simulator_clock_that_stops_without_a_pause_stops_plant_time() {
    let (mut clock, mut simulator) = (Clock::new(), Simulator::new(10.0));
    simulator.run(&mut clock, 3.0, 1.0);
    simulator.run(&mut clock, 3.0, 0.0);
    assert_eq!(simulator.run(&mut clock, 1.0, 0.0), None);
    simulator.run(&mut clock, 3.0, 1.0);
    assert!((clock.rate - 1.0).abs() < 1e-3);
}

#[test]
fn plant_time_never_goes_back_when_the_simulator_restarts() {
    let (mut clock, mut simulator) = (Clock::new(), Simulator::new(5000.0));
    let before = simulator.run(&mut clock, 3.0, 1.0).unwrap();
    simulator.running_s = 0.0;
    let after = simulator.run(&mut clock, 3.0, 1.0).unwrap();
    assert!((after.seconds_since(before) - 3.0).abs() < 0.05);
    assert!((clock.rate - 1.0).abs() < 1e-3);
}

#[test]
fn a_long_silence_counts_as_one_second() {
    let mut clock = Clock::new();
    let start = now();
    clock.frame(start);
    let after = clock.frame(start + Duration::from_secs(60)).unwrap();
    assert_eq!(after, PlantTime::from_seconds(1.0));
}

#[test]
fn a_silence_does_not_affect_the_measured_rate() {
    let (mut clock, mut simulator) = (Clock::new(), Simulator::new(0.0));
    simulator.run(&mut clock, 3.5, 1.0);
    simulator.local_s += 5.0;
    simulator.run(&mut clock, 0.1, 1.0);
    assert!((clock.rate - 1.0).abs() < 1e-3, "{}", clock.rate);
}
