//! The laws this program can fly.

use alloc::boxed::Box;
use alloc::format;
use alloc::string::String;
use alloc::vec::Vec;

use once_cell::race::OnceBox;
use rand::Rng;
use skein_common::id::VehicleId;
use skein_common::scenario::{self, LawNameError, Scenario, add_laws};

use super::UnsupportedScenario;
use super::law::{Law, Setup};
use super::{displacement_consensus, olfati_saber, ring, vasarhelyi, virtual_structure};
use crate::random::{Purpose, generator};

/// Builds a law for one vehicle, or describes what is wrong with its parameters.
pub type MakeLaw = fn(&Setup<'_>) -> Result<Box<dyn Law>, String>;

/// The laws of Skein: the value of `formation.law`, and the function that builds the law.
const BUILT_IN: &[(&str, MakeLaw)] = &[
    ("ring", ring::make),
    ("flock", ring::make),
    ("olfati-saber", olfati_saber::make),
    ("vasarhelyi", vasarhelyi::make),
    ("virtual-structure", virtual_structure::make),
    ("displacement-consensus", displacement_consensus::make),
];

/// The names of Skein's own laws. Tests take them from here, so that they fly a new law too.
pub fn built_in() -> Vec<&'static str> {
    BUILT_IN.iter().map(|(name, _)| *name).collect()
}

/// Laws that a program adds to those of Skein.
#[derive(Clone, Debug, Default)]
pub struct Laws(Vec<(&'static str, MakeLaw)>);

impl Laws {
    /// Adds a law named `name` in scenario files.
    #[must_use]
    pub fn with(mut self, name: &'static str, make: MakeLaw) -> Self {
        self.0.push((name, make));
        self
    }

    /// Registers these laws for the whole program. Call it at most once, before the first scenario is read.
    ///
    /// # Errors
    ///
    /// Returns an error for a name that is in use or misspelt, and for a second call.
    pub fn add(self) -> Result<(), LawNameError> {
        add_laws(self.0.iter().map(|(name, _)| *name).collect())?;
        ADDED.set(Box::new(self)).map_err(|_| LawNameError::Late)
    }
}

/// The laws added to this program. They never change while it runs: like its code, they are not an input of a flight.
static ADDED: OnceBox<Laws> = OnceBox::new();

/// Builds the law of a formation for vehicle `own`.
///
/// # Errors
///
/// A law that this program does not know, or parameters that the law refuses.
pub fn make(
    scenario: &Scenario,
    formation: &scenario::Formation,
    own: VehicleId,
) -> Result<Box<dyn Law>, UnsupportedScenario> {
    let name = formation.law.name();
    let added = ADDED.get().map_or(&[][..], |laws| &laws.0);
    let Some((_, make)) = BUILT_IN.iter().chain(added).find(|(known, _)| *known == name) else {
        return Err(UnsupportedScenario(format!("formation.law = \"{name}\": this program does not know this law")));
    };
    let seed = generator(scenario.seed, Some(own), Purpose::Law).next_u64();
    make(&Setup { own, formation, vehicles: scenario.swarm.vehicles, seed })
        .map_err(|why| UnsupportedScenario(format!("formation.law = \"{name}\": {why}")))
}
