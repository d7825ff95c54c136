//! One flight of a study, tick by tick, and several flights side by side.
//!
//! A job flies as many runs at once as fill the blocks of the flight model: two of four vehicles, one of sixteen. A run
//! measures the same with any other runs beside it.

use std::num::NonZeroUsize;

use skein_common::scenario::Scenario;
use skein_core::helicopter::TICK_S;
use skein_host::blocks::Blocks;
use skein_host::clock::now;
use skein_host::parallel::{Tasks, in_parallel_by};

use super::{JOIN_LIMIT_S, Stop, Study, StudyError, longest_s, measure};
use crate::external::{LawPool, Laws};
use crate::metrics::{Metrics, Report, Run, VehicleNow, Wall};
use crate::recording::Watch;
use crate::world::World;

/// An observer of a flight, and the rate at which it is shown the vehicles' steps, Hz.
pub(super) type Watched<'a> = Option<(&'a mut dyn Watch, f64)>;

/// One flight, from the ground to the end of the window or of the mission.
#[derive(Debug)]
pub(super) struct SeedFlight {
    pub(super) world: World,
    laws: Option<Laws>,
    /// The pool in which the laws wait for their next run.
    pool: LawPool,
    pub(super) metrics: Metrics,
    /// Room to work in.
    vehicles: Vec<VehicleNow>,
    /// Beginning of the window; `None` while vehicles still join, s. That of a team is the fleet's.
    pub(super) zero_s: Option<f64>,
    /// Ticks of the window so far, and at most.
    ticks: u64,
    most_ticks: u64,
    /// Whether the end of the mission ends the flight.
    pub(super) ends_with_mission: bool,
    /// Ends the flight when it is set.
    pub(super) stop: Stop,
    /// The reason why the flight has failed, if it has.
    pub(super) failed: Option<StudyError>,
    /// Wall-clock time spent on this flight, s.
    wall_s: f64,
}

impl SeedFlight {
    /// A flight of this seed, on the ground.
    ///
    /// # Errors
    /// If the scenario cannot be flown, or an external law is gone.
    pub(super) fn new(study: &Study, seed: u64) -> Result<Self, StudyError> {
        let laws = study.laws.take(&Scenario { seed, ..study.scenario.clone() })?;
        Self::with_laws(study, seed, laws)
    }

    /// A flight of this seed with these external laws; without any, the caller answers the agents' queries.
    pub(super) fn with_laws(study: &Study, seed: u64, laws: Option<Laws>) -> Result<Self, StudyError> {
        let started = now();
        let scenario = Scenario { seed, ..study.scenario.clone() };
        let world = World::new(&scenario, &study.aircraft, &study.rules)?;
        Ok(Self {
            world,
            laws,
            pool: study.laws.clone(),
            metrics: Metrics::new(&scenario, Run::new(&scenario, "study")),
            vehicles: Vec::with_capacity(scenario.swarm.vehicles),
            zero_s: None,
            ticks: 0,
            most_ticks: (longest_s(&scenario) / TICK_S).round() as u64,
            ends_with_mission: true,
            stop: Stop::default(),
            failed: None,
            wall_s: now().duration_since(started).as_secs_f64(),
        })
    }

    /// Whether no other flight may be stepped together with this one: one with laws in other programs waits for them and would
    /// keep the others waiting, and one in several threads has its blocks filled by each.
    fn is_alone(&self) -> bool {
        matches!(self.laws, Some(Laws::Programs(_))) || self.world.threads() > NonZeroUsize::MIN
    }

    /// Flies to the end by itself.
    ///
    /// # Errors
    /// If a vehicle does not join, or an external law is silent or gone.
    pub(super) fn fly(mut self, mut watched: Watched<'_>) -> Result<Report, StudyError> {
        let started = now();
        while !self.is_over() {
            self.world.tick();
            self.end_tick(&mut watched);
        }
        self.wall_s += now().duration_since(started).as_secs_f64();
        self.report()
    }

    /// Whether the mission has come to its end, and not only the window.
    pub(super) fn has_finished(&self) -> bool {
        self.ends_with_mission && self.ticks > 0 && self.world.has_finished()
    }

    /// Whether no tick follows. To be asked before each.
    pub(super) fn is_over(&mut self) -> bool {
        if self.stop.is_set() {
            self.failed = Some(StudyError::Stopped);
        }
        if self.zero_s.is_none() && self.failed.is_none() {
            if self.world.all_active() {
                self.zero_s = Some(self.world.t_s());
            } else if self.world.t_s() > JOIN_LIMIT_S {
                self.failed = Some(StudyError::NeverActive);
            }
        }
        let is_at_the_end = || self.ticks == self.most_ticks || self.has_finished();
        self.failed.is_some() || (self.zero_s.is_some() && is_at_the_end())
    }

    /// Serves the laws and measures, after the world's tick.
    pub(super) fn end_tick(&mut self, watched: &mut Watched<'_>) {
        self.failed = self.laws.as_mut().and_then(|laws| laws.serve(&mut self.world).err()).map(Into::into);
        let Some(zero_s) = self.zero_s.filter(|_| self.failed.is_none()) else { return };
        measure(&self.world, zero_s, &mut self.metrics, &mut self.vehicles);
        if let Some((watch, rate_hz)) = watched {
            let every = (1.0 / (TICK_S * *rate_hz)).round().max(1.0) as u64;
            show(&mut self.world, zero_s, *watch, self.ticks.is_multiple_of(every));
        }
        self.ticks += 1;
    }

    /// The figures of the whole flight. Laws of a flight that failed are not kept.
    pub(super) fn report(mut self) -> Result<Report, StudyError> {
        if let Some(error) = self.failed {
            return Err(error);
        }
        self.laws.take().into_iter().for_each(|laws| self.pool.put_back(laws));
        let real_time_factor = self.world.t_s() / self.wall_s.max(1e-9);
        Ok(self.figures(Wall { wall_s: self.wall_s, real_time_factor }))
    }

    /// The figures so far.
    pub(super) fn figures(&mut self, wall: Wall) -> Report {
        self.metrics.set_totals(self.world.totals());
        self.metrics.report(wall)
    }
}

/// Shows the world's last tick to the observer; the vehicles' steps only if they are `due`.
fn show(world: &mut World, zero_s: f64, watch: &mut dyn Watch, due: bool) {
    let t_s = world.t_s() - zero_s;
    world.faults().iter().for_each(|fault| watch.fault(t_s, fault));
    world.events().for_each(|(sender, what)| watch.event(t_s, sender, &what));
    if due {
        world.traces().for_each(|trace| watch.step(t_s, &trace));
    }
}

/// Flies runs 0 to `count` - 1 in `jobs` threads, each of them several side by side. `begin` makes a run's flight, and
/// `end` what becomes of its report; the results are in the order of runs.
///
/// # Errors
/// The first error of a run, in the order of runs.
pub(super) fn fly_side_by_side<Run, T: Send, E: Send>(
    count: usize,
    jobs: NonZeroUsize,
    begin: impl Fn(usize) -> Result<(Run, SeedFlight), E> + Sync,
    end: impl Fn(Run, Result<Report, StudyError>) -> Result<T, E> + Sync,
) -> Result<Vec<T>, E> {
    // No job takes more than its share of the runs.
    let share = count.div_ceil(jobs.get());
    in_parallel_by(count, jobs, |tasks: &Tasks<T, E>| {
        let (mut flights, mut blocks) = (Vec::new(), Blocks::default());
        loop {
            while have_room(&flights, share) {
                let Some(nth) = tasks.take() else { break };
                match begin(nth) {
                    Ok((run, flight)) => flights.push(((nth, run), flight)),
                    Err(error) => tasks.finish(nth, Err(error)),
                }
            }
            let Some(((nth, run), flight)) = fly_until_one_ends(&mut flights, &mut blocks) else { return };
            tasks.finish(nth, end(run, flight.report()));
        }
    })
}

/// Whether one more flight is worth it beside these of one job: the last block has empty lanes.
fn have_room<Run>(flights: &[(Run, SeedFlight)], share: usize) -> bool {
    let vehicles = flights.iter().map(|(_, flight)| flight.world.vehicle_count()).sum();
    let alone = flights.iter().any(|(_, flight)| flight.is_alone());
    flights.len() < share && !alone && !Blocks::are_full(vehicles)
}

/// Flies on until the first of these flights ends, and removes it; `None` without flights.
fn fly_until_one_ends<Run>(flights: &mut Vec<(Run, SeedFlight)>, blocks: &mut Blocks) -> Option<(Run, SeedFlight)> {
    if flights.is_empty() {
        return None;
    }
    let started = now();
    let ended = loop {
        if let Some(ended) = flights.iter_mut().position(|(_, flight)| flight.is_over()) {
            break ended;
        }
        match flights.as_mut_slice() {
            [(_, flight)] => flight.world.tick(),
            flights => World::tick_together(flights.iter_mut().map(|(_, flight)| &mut flight.world), blocks),
        }
        flights.iter_mut().for_each(|(_, flight)| flight.end_tick(&mut None));
    };
    let wall_s = now().duration_since(started).as_secs_f64() / flights.len() as f64;
    flights.iter_mut().for_each(|(_, flight)| flight.wall_s += wall_s);
    Some(flights.remove(ended))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use skein_common::scenario::{Source, load};
    use skein_core::aircraft::Aircraft;
    use skein_core::control::{Rules, Sugeno};

    use super::*;
    use crate::metrics::Measured;
    use crate::metrics::WALL_CLOCK_KEYS;
    use crate::study::under_control;

    fn study(sets: &[&str]) -> Study {
        let text = "duration_s = 30\nworld.wind_m_s = 4\nworld.gust_w20_m_s = 5\n\
                    mission.events = [{ at_s = 12, fault = 'engine_out', vehicle = 1 }]\n";
        let source = Source { name: "test", text };
        let scenario = load(&source, &sets.iter().map(ToString::to_string).collect::<Vec<_>>()).unwrap().scenario;
        let aircraft = vec![Aircraft::shipped("xcell60").unwrap().unwrap(); scenario.swarm.vehicles];
        Study { scenario, aircraft, rules: Rules::shipped(), laws: LawPool::default() }
    }

    fn without_wall_clock(report: &Report) -> Measured {
        let mut measured = Measured::of(report);
        measured.figures.retain(|key, _| !WALL_CLOCK_KEYS.contains(&key.as_str()));
        measured
    }

    #[test]
    fn runs_side_by_side_measure_the_same_as_each_alone() {
        for vehicles in [3, 4] {
            let study = study(&[&format!("swarm.vehicles={vehicles}")]);
            let alone: Vec<_> = (0..5).map(|seed| without_wall_clock(&study.fly(seed).unwrap())).collect();
            for jobs in [1, 2, 5] {
                let reports = study.fly_all(0..5, NonZeroUsize::new(jobs).unwrap(), |_| {}).unwrap();
                assert_eq!(reports.iter().map(without_wall_clock).collect::<Vec<_>>(), alone, "{jobs} jobs");
            }
            assert_ne!(alone[0].figures, alone[1].figures, "another seed flies differently");
        }
    }

    #[test]
    fn a_run_in_several_threads_measures_the_same_as_in_one() {
        for sets in [&["swarm.vehicles=21"][..], &["swarm.vehicles=9", "control.mode=central"]] {
            let study = study(sets);
            let flown = |threads| {
                let mut flight = SeedFlight::new(&study, 1).unwrap();
                flight.world.set_threads(NonZeroUsize::new(threads).unwrap());
                without_wall_clock(&flight.fly(None).unwrap())
            };
            let one = flown(1);
            for threads in [2, 3, 30] {
                assert_eq!(flown(threads), one, "{threads} threads, {sets:?}");
            }
        }
    }

    #[test]
    fn a_swarm_that_spins_has_failed() {
        let shipped = study(&["swarm.vehicles=2", "duration_s=60", "mission.events=[]"]);
        let measured = Measured::of(&shipped.fly(1).unwrap());
        assert!(measured.uncontrolled.is_empty() && under_control(&measured).is_ok(), "{:?}", measured.figures);
        // Outputs of another job: far beyond the travel, so that the yaw control is at one stop or the other.
        let text = include_str!("../../../controllers/heading.fis");
        let line = |line: &str| if line.contains("'constant',[-") { line.replace("[-", "[") } else { line.to_owned() };
        let text =
            text.lines().map(|text| line(text).replace("'constant',[0.", "'constant',[300.")).collect::<Vec<_>>();
        let heading = Arc::new(Sugeno::parse("other.fis", &text.join("\n")).unwrap());
        let other = Study { rules: Rules { heading, ..Rules::shipped() }, ..shipped };
        let measured = Measured::of(&other.fly(1).unwrap());
        let why = under_control(&measured).unwrap_err();
        assert!(
            why.contains("a flight with a vehicle that does not keep its heading (vehicles 1 and 2: up to"),
            "{why}"
        );
        assert!(
            why.contains("a flight with controls at their stops (vehicles 1 and 2: up to 100 % of the time"),
            "{why}"
        );
        let turn_rate_deg_s = measured.figures["max_turn_rate_deg_s"].unwrap();
        assert!(turn_rate_deg_s > 60.0, "{turn_rate_deg_s}");
    }

    #[test]
    fn a_flight_ends_when_it_is_stopped() {
        let stop = Stop::default();
        let mut flight = SeedFlight::new(&study(&["swarm.vehicles=2"]), 1).unwrap();
        flight.stop = stop.clone();
        assert!(!flight.is_over());
        stop.set();
        assert!(matches!(flight.fly(None), Err(StudyError::Stopped)));
    }

    #[test]
    fn a_job_flies_as_many_runs_side_by_side_as_fill_its_blocks() {
        for (vehicles, share, expected) in [(4, 9, 2), (8, 9, 1), (3, 9, 5), (3, 2, 2), (16, 9, 1)] {
            let study = study(&[&format!("swarm.vehicles={vehicles}")]);
            let mut flights = Vec::new();
            while have_room(&flights, share) {
                flights.push(((), SeedFlight::new(&study, 1).unwrap()));
            }
            assert_eq!(flights.len(), expected, "{vehicles} vehicles, at most {share} runs");
        }
    }
}
