//! Many worlds of one scenario that are stepped together from outside, such as an environment for learning.
//!
//! A world of a batch measures the same as a run of a study with the same seed, if its pilot does nothing.

use std::num::NonZeroUsize;

use skein_core::helicopter::TICK_S;
use skein_host::blocks::Blocks;
use skein_host::parallel::at_once;

use super::flight::SeedFlight;
use super::{Study, StudyError};
use crate::metrics::{Metrics, Report};
use crate::world::World;

/// A world waits this long for its pilot to be ready, s.
const READY_LIMIT_S: f64 = 60.0;

/// Acts on one world of a batch.
pub trait Pilot: Send {
    /// A new flight begins.
    fn begin(&mut self);
    /// Acts before so many ticks.
    fn before(&mut self, world: &mut World, ticks: u64);
    /// Acts after each tick.
    fn after_tick(&mut self, world: &mut World);
    /// Whether the first observation is due.
    fn is_ready(&self) -> bool;
}

/// The part of a flight that the pilots of a batch replace.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Replaced {
    /// Nothing: the scenario's own law flies.
    Nothing,
    /// The law: the pilots answer the agents' queries, in place of the scenario's external law.
    Law,
    /// The controls of the vehicles. An agent that gives up because its vehicle does not follow does not end the flight.
    Controls,
}

/// Worlds of one scenario, each with a flight of its own.
#[derive(Debug)]
pub struct Batch {
    /// The study whose runs fly here.
    pub study: Study,
    replaced: Replaced,
    flights: Vec<Option<SeedFlight>>,
    /// Room for the flight models, for each thread.
    blocks: Vec<Blocks>,
    /// Worlds whose vehicles fill a block.
    side_by_side: usize,
}

impl Batch {
    /// A batch of this many worlds, which have not begun. This many threads step them.
    pub fn new(study: Study, worlds: usize, threads: NonZeroUsize, replaced: Replaced) -> Self {
        let vehicles = study.scenario.swarm.vehicles;
        let side_by_side = (1..worlds.max(1)).find(|worlds| Blocks::are_full(worlds * vehicles)).unwrap_or(1);
        let blocks = (0..threads.get()).map(|_| Blocks::default()).collect();
        Self { study, replaced, flights: (0..worlds).map(|_| None).collect(), blocks, side_by_side }
    }

    /// Begins new flights in the worlds that have a seed here, and flies them until all vehicles have joined and the
    /// pilot is ready.
    ///
    /// # Errors
    /// If the scenario cannot be flown, or a vehicle does not join.
    pub fn begin<P: Pilot>(&mut self, seeds: &[Option<u64>], pilots: &mut [P]) -> Result<(), StudyError> {
        let Self { study, replaced, flights, blocks, .. } = self;
        let share = flights.len().div_ceil(blocks.len()).max(1);
        let shares = flights.chunks_mut(share).zip(pilots.chunks_mut(share)).zip(seeds.chunks(share));
        let begun = at_once(shares.map(|((flights, pilots), seeds)| {
            let (study, replaced) = (&*study, *replaced);
            move || {
                for ((flight, pilot), seed) in flights.iter_mut().zip(pilots).zip(seeds) {
                    if let Some(seed) = seed {
                        *flight = Some(begun(study, *seed, replaced, pilot)?);
                    }
                }
                Ok::<_, StudyError>(())
            }
        }));
        begun.into_iter().collect()
    }

    /// Simulates so many frames of every world that has begun and is not over.
    ///
    /// # Errors
    /// If a flight has failed.
    pub fn tick<P: Pilot>(&mut self, ticks: u64, pilots: &mut [P]) -> Result<(), StudyError> {
        let Self { flights, blocks, side_by_side, .. } = self;
        let share = flights.len().div_ceil(blocks.len()).next_multiple_of(*side_by_side);
        let shares = flights.chunks_mut(share).zip(pilots.chunks_mut(share)).zip(blocks);
        at_once(shares.map(|((flights, pilots), blocks)| {
            let side_by_side = *side_by_side;
            move || {
                for (flights, pilots) in flights.chunks_mut(side_by_side).zip(pilots.chunks_mut(side_by_side)) {
                    tick_together(flights, pilots, ticks, blocks);
                }
            }
        }));
        let is_failed = |flight: &&mut Option<SeedFlight>| flight.as_ref().is_some_and(|it| it.failed.is_some());
        match self.flights.iter_mut().find(is_failed).and_then(Option::take) {
            Some(failed) => failed.report().map(|_| ()),
            None => Ok(()),
        }
    }

    /// The world at this place and what is measured of it; `None` before it begins.
    pub fn world(&self, nth: usize) -> Option<(&World, &Metrics)> {
        let flight = self.flights.get(nth)?.as_ref()?;
        Some((&flight.world, &flight.metrics))
    }

    /// Whether the flight at this place is over: its mission has finished, and its window has ended.
    pub fn is_over(&mut self, nth: usize) -> [bool; 2] {
        match self.flights.get_mut(nth).and_then(Option::as_mut) {
            Some(flight) => [flight.has_finished(), flight.is_over()],
            None => [false, false],
        }
    }

    /// Ends the flight at this place and gives what was measured; `None` before it begins.
    ///
    /// # Errors
    /// If the flight has failed.
    pub fn report(&mut self, nth: usize) -> Result<Option<Report>, StudyError> {
        self.flights.get_mut(nth).and_then(Option::take).map(SeedFlight::report).transpose()
    }
}

/// A flight of this seed, flown until its pilot is ready.
fn begun(study: &Study, seed: u64, replaced: Replaced, pilot: &mut impl Pilot) -> Result<SeedFlight, StudyError> {
    let mut flight = match replaced {
        Replaced::Law => SeedFlight::with_laws(study, seed, None)?,
        Replaced::Nothing | Replaced::Controls => SeedFlight::new(study, seed)?,
    };
    flight.ends_with_mission = !matches!(replaced, Replaced::Controls);
    let mut waited = 0;
    pilot.begin();
    while !flight.is_over() && (flight.zero_s.is_none() || !pilot.is_ready()) {
        if flight.zero_s.is_some() {
            waited += 1;
            if f64::from(waited) * TICK_S > READY_LIMIT_S {
                break;
            }
        }
        flight.world.tick();
        pilot.after_tick(&mut flight.world);
        flight.end_tick(&mut None);
    }
    match &flight.failed {
        Some(_) => flight.report().and(Err(StudyError::NeverActive)),
        None => Ok(flight),
    }
}

/// Simulates so many frames of these worlds in common blocks.
fn tick_together<P: Pilot>(flights: &mut [Option<SeedFlight>], pilots: &mut [P], ticks: u64, blocks: &mut Blocks) {
    let flights = flights.iter_mut().zip(pilots).filter_map(|(flight, pilot)| Some((flight.as_mut()?, pilot)));
    let mut flying: Vec<(&mut SeedFlight, &mut P)> =
        flights.filter_map(|(f, p)| (!f.is_over()).then_some((f, p))).collect();
    flying.iter_mut().for_each(|(flight, pilot)| pilot.before(&mut flight.world, ticks));
    for _ in 0..ticks {
        match flying.as_mut_slice() {
            [] => return,
            [(flight, _)] => flight.world.tick(),
            flying => World::tick_together(flying.iter_mut().map(|(flight, _)| &mut flight.world), blocks),
        }
        for (flight, pilot) in &mut flying {
            pilot.after_tick(&mut flight.world);
            flight.end_tick(&mut None);
        }
        flying.retain_mut(|(flight, _)| !flight.is_over());
    }
}

#[cfg(test)]
mod tests {
    use skein_common::scenario::{Source, load};
    use skein_core::aircraft::Aircraft;
    use skein_core::control::Rules;
    use skein_core::plant::Controls;

    use super::*;
    use crate::external::LawPool;
    use crate::metrics::{Measured, WALL_CLOCK_KEYS};

    fn study() -> Study {
        let source = Source { name: "test", text: "duration_s = 12\nswarm.vehicles = 3\n" };
        let scenario = load(&source, &[]).unwrap().scenario;
        let aircraft = vec![Aircraft::shipped("xcell60").unwrap().unwrap(); scenario.swarm.vehicles];
        Study { scenario, aircraft, rules: Rules::shipped(), laws: LawPool::default() }
    }

    /// Holds the collective after so many ticks, if it has one.
    #[derive(Default)]
    struct Hand {
        collective: Option<f64>,
    }

    impl Pilot for Hand {
        fn begin(&mut self) {}

        fn before(&mut self, world: &mut World, _: u64) {
            let ids: Vec<_> = world.frames().map(|(id, ..)| id).collect();
            let controls = self.collective.map(|collective| Controls { collective, ..Controls::default() });
            ids.into_iter().for_each(|id| world.set_controls(id, controls));
        }

        fn after_tick(&mut self, _: &mut World) {}

        fn is_ready(&self) -> bool {
            true
        }
    }

    fn measured(report: &Report) -> Measured {
        let mut measured = Measured::of(report);
        measured.figures.retain(|key, _| !WALL_CLOCK_KEYS.contains(&key.as_str()));
        measured
    }

    #[test]
    fn worlds_without_pilots_measure_as_the_runs_of_a_study_in_any_number_of_threads() {
        let alone: Vec<_> = (4..9).map(|seed| measured(&study().fly(seed).unwrap())).collect();
        for threads in [1, 2] {
            let mut batch = Batch::new(study(), 5, NonZeroUsize::new(threads).unwrap(), Replaced::Nothing);
            let mut pilots: Vec<Hand> = (0..5).map(|_| Hand::default()).collect();
            assert!(batch.world(0).is_none());
            batch.begin(&(4..9).map(Some).collect::<Vec<_>>(), &mut pilots).unwrap();
            while !(0..5).all(|nth| batch.is_over(nth)[1]) {
                batch.tick(7, &mut pilots).unwrap();
            }
            let flown: Vec<_> = (0..5).map(|nth| measured(&batch.report(nth).unwrap().unwrap())).collect();
            assert_eq!(flown, alone, "{threads} threads");
        }
    }

    #[test]
    fn a_pilot_moves_the_controls_of_its_world_alone() {
        let mut batch = Batch::new(study(), 2, NonZeroUsize::MIN, Replaced::Controls);
        let mut pilots = [Hand { collective: Some(1.0) }, Hand { collective: Some(0.0) }];
        batch.begin(&[Some(1), Some(1)], &mut pilots).unwrap();
        batch.tick(100, &mut pilots).unwrap();
        let heights =
            [0, 1].map(|nth| batch.world(nth).unwrap().0.frames().map(|(.., f)| f.truth.height_m).fold(0.0, f64::max));
        assert!(heights[0] > 2.0 && heights[1] < 1.0, "{heights:?}");
    }
}
