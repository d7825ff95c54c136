//! Points that follow a law's command at once: the claims of a law's source are checked on these, without a
//! helicopter's lag.

use nalgebra::Vector2;
use skein_common::frame::{PositionNed, VelocityNed};
use skein_common::id::VehicleId;
use skein_common::scenario::{Source, load};

use super::super::law::{Goal, Law, LawCommand, Neighbour, Observation};
use super::super::laws;
use crate::random::{Purpose, generator, uniform};

/// Points around a goal; vehicle i + 1 is point i.
#[derive(Clone, Debug)]
pub(in crate::formation) struct Points {
    pub(in crate::formation) places_m: Vec<Vector2<f64>>,
    pub(in crate::formation) velocities_m_s: Vec<Vector2<f64>>,
    pub(in crate::formation) goal: Goal,
}

impl Points {
    /// `count` points at rest, scattered over a square, with the goal at rest.
    pub(in crate::formation) fn scattered(count: usize, square_m: f64, seed: u64) -> Self {
        let mut rng = generator(seed, None, Purpose::Start);
        let mut coordinate_m = || square_m * (uniform(&mut rng) - 0.5);
        Self::at((0..count).map(|_| Vector2::new(coordinate_m(), coordinate_m())).collect())
    }

    /// Points at rest at these positions, with the goal at rest at the origin.
    pub(in crate::formation) fn at(places_m: Vec<Vector2<f64>>) -> Self {
        let goal = Goal {
            step: 0,
            centre: PositionNed::default(),
            centre_velocity: VelocityNed::default(),
            heading_rad: 0.0,
            radius_m: 100.0,
            gamma: 1.0,
        };
        Self { velocities_m_s: vec![Vector2::zeros(); places_m.len()], places_m, goal }
    }

    pub(in crate::formation) fn pass(&mut self, dt_s: f64) {
        self.places_m.iter_mut().zip(&self.velocities_m_s).for_each(|(place, velocity)| *place += velocity * dt_s);
        self.goal.centre = self.goal.centre + self.goal.centre_velocity.0 * dt_s;
    }

    /// The results of `update` for the observation of each point; `receives(i, j)` states whether point i receives point
    /// j.
    pub(in crate::formation) fn each<T>(
        &self,
        receives: impl Fn(usize, usize) -> bool,
        mut update: impl FnMut(usize, &Observation<'_>) -> T,
    ) -> Vec<T> {
        let count = self.places_m.len();
        let received =
            |own: usize| (0..count).filter(|&other| other != own && receives(own, other)).collect::<Vec<_>>();
        let mut one = |own: usize| {
            let neighbours: Vec<_> = received(own).into_iter().map(|other| self.neighbour(other)).collect();
            let Neighbour { id, position, velocity, heading_rad, .. } = self.neighbour(own);
            let goal = self.goal;
            let neighbours = &neighbours[..];
            let members = neighbours.iter().map(|neighbour| neighbour.id).collect();
            let (obstacles, dt_s) = (&[][..], 0.02);
            let observation =
                Observation { own: id, position, velocity, heading_rad, neighbours, members, obstacles, goal, dt_s };
            update(own, &observation)
        };
        (0..count).map(&mut one).collect()
    }

    /// All points follow their laws' commands for this time.
    pub(in crate::formation) fn fly(
        &mut self,
        laws: &mut [Box<dyn Law>],
        receives: impl Fn(usize, usize) -> bool,
        for_s: f64,
    ) {
        let dt_s = 0.02;
        for _ in 0..(for_s / dt_s) as usize {
            self.velocities_m_s =
                self.each(&receives, |own, observation| match laws[own].update(observation).command {
                    LawCommand::Velocity { ne_m_s, .. } => ne_m_s,
                    LawCommand::Displacement(displacement_ne_m) => {
                        displacement_ne_m / 2.0 + observation.goal.centre_velocity.horizontal()
                    }
                    LawCommand::Field(field) => field.xy(),
                });
            self.pass(dt_s);
        }
    }

    /// Distances of all pairs, m.
    pub(in crate::formation) fn distances_m(&self) -> Vec<f64> {
        let places_m = &self.places_m;
        let pairs = places_m.iter().enumerate().flat_map(|(nth, one)| places_m[..nth].iter().map(move |it| it - one));
        pairs.map(|apart_m| apart_m.norm()).collect()
    }

    fn neighbour(&self, nth: usize) -> Neighbour {
        let (place, velocity) = (self.places_m[nth], self.velocities_m_s[nth]);
        Neighbour {
            id: VehicleId::new(nth as u8 + 1).unwrap(),
            position: PositionNed::new(place.x, place.y, 0.0),
            velocity: VelocityNed::new(velocity.x, velocity.y, 0.0),
            heading_rad: 0.0,
            age_s: 0.0,
            is_fresh: true,
        }
    }
}

/// A law for each of `count` vehicles, with these lines under `[formation]`.
pub(in crate::formation) fn laws(count: usize, lines: &str) -> Vec<Box<dyn Law>> {
    let text = format!("swarm.vehicles = {count}\n[formation]\n{lines}");
    let scenario = load(&Source { name: "test.toml", text: &text }, &[]).unwrap().scenario;
    scenario.ids().map(|own| laws::make(&scenario, &scenario.formation, own).unwrap()).collect()
}
