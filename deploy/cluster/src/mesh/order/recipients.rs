//! The vehicles to which an order is sent: those of one swarm, or of some teams of a fleet.

use std::collections::BTreeMap;

use skein_common::id::{TeamId, VehicleId, VehicleName, VehicleSet};
use skein_common::message::Verb;
use skein_lab::error::Error;

use super::effect::ranges;
use crate::keys::Role;
use crate::mesh::reach::{Place, Reach};

/// The recipients of an order in one swarm, or in one team of a fleet.
pub(crate) struct Recipients {
    /// Everything needed to connect to the swarm as an operator.
    pub(crate) reach: Reach,
    /// The vehicles; `None` for all of the swarm.
    pub(crate) vehicles: Option<VehicleSet>,
}

impl Recipients {
    /// These vehicles of each of these teams; without `teams` of all teams, or of the one swarm, and without `vehicles` all of
    /// them.
    ///
    /// # Errors
    /// If the fleet has no such team, or the operator's keys are missing.
    pub(super) fn of_teams(place: &Place, teams: &[TeamId], vehicles: Option<VehicleSet>) -> Result<Vec<Self>, Error> {
        let reaches = place.reach_teams(Role::Operator, teams)?;
        Ok(reaches.into_iter().map(|reach| Self { reach, vehicles }).collect())
    }

    /// The vehicles with these names, which may be of several teams.
    ///
    /// # Errors
    /// If the list is empty, a vehicle of this name does not fly there, or the operator's keys are missing.
    pub(super) fn of_names(place: &Place, names: &[VehicleName]) -> Result<Vec<Self>, Error> {
        let mut chosen = BTreeMap::<Option<TeamId>, VehicleSet>::new();
        for name in names {
            chosen.entry(name.team).or_default().insert(name.vehicle);
        }
        let mut all = Vec::new();
        for reach in place.reach_teams(Role::Operator, &[])? {
            if let Some(vehicles) = chosen.remove(&reach.branch.team()) {
                all.push(Self { reach, vehicles: Some(vehicles) });
            }
        }
        if let Some((&team, vehicles)) = chosen.first_key_value() {
            let vehicle = vehicles.iter().next();
            let unknown = vehicle.map_or_else(String::new, |vehicle| VehicleName { team, vehicle }.to_string());
            return Err(Error::Refused(format!("swarm {} has no vehicle {unknown}", place.swarm())));
        }
        if all.is_empty() {
            return Err(Error::Refused("the order names no vehicle: select some, or order all".to_owned()));
        }
        Ok(all)
    }

    /// Checks that this order can be sent to these vehicles.
    ///
    /// # Errors
    /// If a swarm has no such vehicle, or a release does not name the vehicles whose controls it gives away.
    pub(super) fn check(verb: Verb, all: &[Self]) -> Result<(), Error> {
        for Self { reach, vehicles } in all {
            let Some(vehicles) = vehicles else {
                let why = "release: name the vehicles that human pilots are to fly, such as --vehicles 3";
                return if verb == Verb::Release { Err(Error::Refused(why.to_owned())) } else { Ok(()) };
            };
            if let Verb::Set(setting) = verb {
                return Err(Error::Refused(format!("set {setting}: it is for the whole swarm, without --vehicles")));
            }
            let own: Vec<VehicleId> = reach.agents.keys().copied().collect();
            let unknown = vehicles.without(own.iter().copied().collect());
            if !unknown.is_empty() {
                let (title, own) = (reach.title(), ranges(&own));
                return Err(Error::Refused(format!(
                    "{verb}: {title} has no vehicle {unknown}; its vehicles are {own}"
                )));
            }
        }
        Ok(())
    }

    /// Whether the order is to this vehicle of the swarm.
    pub(super) fn contain(&self, id: VehicleId) -> bool {
        self.vehicles.is_none_or(|vehicles| vehicles.contains(id))
    }
}
