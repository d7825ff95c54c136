//! Observes all of a cluster: its swarm, or every team of its fleet.

use std::time::Instant;

use skein_common::id::VehicleName;
use skein_common::message::Health;
use skein_host::parallel::at_once;

use super::{ObserveError, Observer, VehicleView, run_in_flight};
use crate::mesh::reach::Reach;

/// An observer of the swarm, or of each team of the fleet.
pub struct Observers(Vec<Observer>);

impl Observers {
    /// Connects to all of them at once.
    ///
    /// # Errors
    /// The errors of [`Observer::open`].
    pub fn open(reaches: &[Reach]) -> Result<Self, ObserveError> {
        let opened = at_once(reaches.iter().map(|reach| || Observer::open(reach)));
        opened.into_iter().collect::<Result<_, _>>().map(Self)
    }

    /// The observer of each swarm or team, in the order of the teams.
    pub fn each(&mut self) -> &mut [Observer] {
        &mut self.0
    }

    /// The observer of each swarm or team, as [`Self::each`].
    pub fn all(&self) -> &[Observer] {
        &self.0
    }

    /// Receives all messages that have arrived.
    pub fn poll(&mut self) {
        self.0.iter_mut().for_each(|observer| drop(observer.poll()));
    }

    /// The newest data of this vehicle, if it has appeared or sent a message.
    pub fn view(&self, name: VehicleName) -> Option<&VehicleView> {
        self.of(name)?.vehicles().get(&name.vehicle)
    }

    /// The newest data of every vehicle that has appeared or sent a message.
    pub fn views(&self) -> impl Iterator<Item = (VehicleName, &VehicleView)> + Clone {
        self.0.iter().flat_map(|observer| {
            let branch = observer.branch();
            observer.vehicles().iter().map(move |(id, view)| (branch.name(*id), view))
        })
    }

    /// The run that the vehicles fly in, as [`Observer::run`], by those of all teams: teams of one fleet fly in one run.
    pub fn run(&self) -> Option<u64> {
        run_in_flight(self.views().map(|(_, view)| view), self.0.first().and_then(|observer| observer.reach.own_run))
    }

    /// The newest health report of a vehicle, as [`Observer::health_of`], in the run that all teams fly in.
    pub fn health_of(&self, name: VehicleName) -> Option<(&Health, Instant)> {
        self.of(name)?.health_in(name.vehicle, self.run())
    }

    fn of(&self, name: VehicleName) -> Option<&Observer> {
        self.0.iter().find(|observer| observer.branch().team() == name.team)
    }
}
