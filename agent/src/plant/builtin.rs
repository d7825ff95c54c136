//! Flies the built-in vehicle in real time: an agent's plant without a simulator.

use std::time::{Duration, Instant};

use skein_core::builtin::{BuiltInPlant, NoFlightModel};
use skein_core::helicopter::failures::ActiveFaults;
use skein_core::helicopter::{Script, TICK_S};
use skein_core::pilot::SimulatedPilot;
use skein_core::plant::{Command, Frame, Plant, PlantDrops, PlantStatus, Wake};
use skein_core::start::starts;
use skein_host::clock::{now, sleep_until};

use super::{PlantError, PlantVehicle};

/// A vehicle that advances one tick of 20 ms at each deadline of a fixed grid.
///
/// A late tick is run at once if the next one is not due yet. Further ticks are skipped and counted, never run in a
/// burst: simulated time then falls behind, as a simulator's does on a slow computer, so the plant time of every frame
/// is the time that the vehicle has really flown.
///
/// The script of failures starts with the first command and runs on the computer's clock, because it may freeze the
/// simulator and with it simulated time. If an earlier agent has flown the vehicle, the script continues from there.
pub struct BuiltIn {
    vehicle: BuiltInPlant,
    /// Flies the vehicle while the agent has released it.
    pilot: SimulatedPilot,
    script: Script,
    /// The start of the script, and the part of it that was over by then, s.
    script_since: Option<(Instant, f64)>,
    command: Option<Command>,
    /// The command that moved the vehicle in the last tick: the agent's or the pilot's.
    moved_by: Option<Command>,
    tick_at: Option<Instant>,
    skipped: u64,
}

const TICK: Duration = Duration::from_nanos((TICK_S * 1e9) as u64);

impl BuiltIn {
    /// Simulated time starts with the first [`Plant::wait`]. The script starts now if an earlier agent has flown for
    /// `flown_s`.
    pub fn new(vehicle: BuiltInPlant, pilot: SimulatedPilot, script: Script, flown_s: Option<f64>) -> Self {
        let script_since = flown_s.map(|flown_s| (now(), flown_s));
        Self { vehicle, pilot, script, script_since, command: None, moved_by: None, tick_at: None, skipped: 0 }
    }

    /// Current state of the script. No failure occurs before the first command.
    fn script_now(&self) -> ActiveFaults {
        let since = |(at, flown_s)| self.script.at(flown_s + now().saturating_duration_since(at).as_secs_f64());
        self.script_since.map(since).unwrap_or_default()
    }

    /// Runs the next tick when it is due; `None` if the deadline comes first.
    fn next_frame(&mut self, deadline: Instant) -> Option<Frame> {
        let tick_at = *self.tick_at.get_or_insert_with(|| now() + TICK);
        sleep_until(tick_at.min(deadline));
        if deadline < tick_at {
            return None;
        }
        let ActiveFaults { failures, simulator_frozen } = self.script_now();
        if simulator_frozen {
            // A new grid starts after the freeze: frozen ticks do not count as skipped.
            self.tick_at = None;
            sleep_until(deadline);
            return None;
        }
        self.vehicle.fail(failures);
        self.moved_by = self.pilot.fly(self.command, || self.vehicle.frame());
        self.vehicle.advance(self.moved_by);
        let (next, skipped) = next_tick(tick_at, now());
        self.tick_at = Some(next);
        self.skipped += skipped;
        Some(self.vehicle.frame())
    }
}

impl Plant for BuiltIn {
    fn wait(&mut self, timeout: Duration) -> Wake {
        let frame = self.next_frame(now() + timeout);
        let controls = self.moved_by.and_then(Command::controls);
        Wake { frame, status: PlantStatus { controls, ..PlantStatus::default() } }
    }

    fn command(&mut self, command: Command) {
        self.script_since.get_or_insert_with(|| (now(), 0.0));
        self.command = Some(command);
    }

    fn release(&mut self) {
        self.command = None;
    }

    fn frame_period_s(&self) -> f64 {
        TICK_S
    }

    fn drops(&self) -> PlantDrops {
        PlantDrops { skipped_frames: self.skipped, ..PlantDrops::default() }
    }
}

/// The built-in vehicle at its start.
///
/// # Errors
/// An aircraft without a flight model, or a start area that is too small.
pub(super) fn at_start(vehicle: &PlantVehicle<'_>) -> Result<BuiltInPlant, PlantError> {
    let &PlantVehicle { scenario, id, aircraft, .. } = vehicle;
    let starts = starts(scenario).map_err(PlantError::StartArea)?;
    let start = &starts[usize::from(id.get()) - 1];
    BuiltInPlant::new(scenario, id, aircraft, start).map_err(|NoFlightModel| {
        let name = scenario.vehicle(id).map(|vehicle| vehicle.aircraft.clone());
        PlantError::NoModel(name.unwrap_or_default())
    })
}

/// The plant that flies this vehicle, with the scenario's failures and its simulated pilot.
pub(super) fn open(built_in: &BuiltInPlant, vehicle: &PlantVehicle<'_>) -> BuiltIn {
    let &PlantVehicle { scenario, id, aircraft, rules, flown_s } = vehicle;
    let script = Script::of(&scenario.mission.events, id);
    BuiltIn::new(built_in.clone(), SimulatedPilot::new(scenario, aircraft, rules), script, flown_s)
}

/// The next deadline of the grid, at most one tick before `now`, and the number of ticks skipped for it. `tick_at` is
/// the deadline that is served at `now`.
fn next_tick(tick_at: Instant, now: Instant) -> (Instant, u64) {
    let late_ticks = now.saturating_duration_since(tick_at).as_nanos() / TICK.as_nanos();
    let skipped = u32::try_from(late_ticks.saturating_sub(1)).unwrap_or(u32::MAX - 1);
    (tick_at + TICK * (skipped + 1), skipped.into())
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Geodetic, Origin};
    use skein_common::id::VehicleId;
    use skein_common::scenario::{EventAction, Fault, ScriptedEvent, Source, load};
    use skein_core::plant::Controls;

    use super::*;
    use skein_core::aircraft::Aircraft;
    use skein_core::control::Rules;
    use skein_core::helicopter::{BuiltInVehicle, Failures, Start, Weather};

    fn plant(script: Script) -> BuiltIn {
        let aircraft = Aircraft::shipped("xcell60").unwrap().unwrap();
        let scenario = load(&Source { name: "x", text: "swarm.vehicles = 1" }, &[]).unwrap().scenario;
        let pilot = SimulatedPilot::new(&scenario, &aircraft, &Rules::shipped());
        let parameters = aircraft.helicopter.unwrap();
        let origin = Origin::new(Geodetic::from_degrees(28.0, -82.0, 0.0));
        let id = VehicleId::new(1).unwrap();
        let (start, weather) = (Start::default(), Weather::default());
        let vehicle = BuiltInVehicle::new(&origin, &parameters, &start, &weather, 1, id);
        BuiltIn::new(BuiltInPlant::Helicopter(Box::new(vehicle)), pilot, script, None)
    }

    fn failures(plant: &BuiltIn) -> Failures {
        let BuiltInPlant::Helicopter(vehicle) = &plant.vehicle else { panic!("a point mass") };
        vehicle.failures()
    }

    #[test]
    fn late_ticks_are_skipped_and_the_grid_is_kept() {
        let tick_at = now();
        let ms = Duration::from_millis;
        for (late_ms, next_ms, skipped) in
            [(0, 20, 0), (19, 20, 0), (21, 20, 0), (39, 20, 0), (41, 40, 1), (205, 200, 9)]
        {
            assert_eq!(
                next_tick(tick_at, tick_at + ms(late_ms)),
                (tick_at + ms(next_ms), skipped),
                "{late_ms} ms late"
            );
        }
    }

    #[test]
    fn frames_are_one_tick_apart_and_deadlines_are_kept() {
        let mut plant = plant(Script::default());
        let begin = now();
        assert_eq!(plant.wait(TICK / 4).frame, None);
        assert!(now() >= begin + TICK / 4);
        let mut times = Vec::new();
        while times.len() < 10 {
            if let Some(frame) = plant.wait(2 * TICK).frame {
                times.push(frame.time);
            }
        }
        assert!(now() >= begin + 10 * TICK, "faster than real time");
        for (tick, time) in (1..).zip(times) {
            assert_eq!(time.nanoseconds(), tick * TICK.as_nanos() as u64);
        }
    }

    #[test]
    fn a_script_continues_after_an_earlier_agent() {
        let vehicle = VehicleId::new(1).unwrap();
        let fault = |at_s, for_s, fault| ScriptedEvent { at_s, for_s, what: EventAction::Fault(fault) };
        let over = fault(10.0, Some(80.0), Fault::EngineOut { vehicle });
        let lasting = fault(20.0, None, Fault::GyroOff { vehicle });
        let BuiltIn { vehicle, pilot, script, .. } = plant(Script::of(&[over, lasting], vehicle));
        let mut plant = BuiltIn::new(vehicle, pilot, script, Some(95.0));
        assert!(plant.wait(2 * TICK).frame.is_some());
        let failures = failures(&plant);
        assert!(failures.gyro_off && !failures.engine_out, "{failures:?}");
    }

    #[test]
    fn a_frozen_simulator_delivers_no_frame_and_its_time_stops() {
        let vehicle = VehicleId::new(1).unwrap();
        let fault = |at_s, for_s, fault| ScriptedEvent { at_s, for_s, what: EventAction::Fault(fault) };
        let freeze = fault(0.2, Some(0.3), Fault::SimulatorFreeze { vehicle });
        let engine_out = fault(0.0, Some(0.1), Fault::EngineOut { vehicle });
        let mut plant = plant(Script::of(&[freeze, engine_out], vehicle));
        // The script starts only with the first command.
        let Some(first) = plant.wait(2 * TICK).frame else { panic!("no frame") };
        assert!(!failures(&plant).engine_out);
        plant.command(Command::Controls(Controls::default()));
        let begin = now();
        let (mut frames, mut deadlines) = (Vec::new(), Vec::new());
        while now() < begin + Duration::from_millis(800) {
            let deadline = now() + 3 * TICK / 2;
            match plant.wait(3 * TICK / 2).frame {
                Some(frame) => frames.push((now() - begin, frame.time, failures(&plant).engine_out)),
                None => {
                    assert!(now() >= deadline, "the wait ended early");
                    deadlines.push(now() - begin);
                }
            }
        }
        let ms = Duration::from_millis;
        assert!(deadlines.iter().any(|&at| at > ms(400)), "{deadlines:?}");
        assert!(frames.iter().all(|&(at, ..)| at < ms(230) || at >= ms(500)), "{frames:?}");
        assert!(frames.iter().any(|&(at, ..)| at < ms(200)) && frames.iter().any(|&(at, ..)| at > ms(500)));
        assert!(frames[0].2 && !frames[frames.len() - 1].2, "the engine stops at once and restarts later");
        // Frames are a tick apart, even across the freeze.
        for (tick, (_, time, _)) in (1..).zip(&frames) {
            assert_eq!(time.nanoseconds(), first.time.nanoseconds() + tick * TICK.as_nanos() as u64);
        }
    }
}
