//! Which laws there are, by name: those of Skein, and those that the program at hand brings along.

use std::sync::OnceLock;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

/// `formation.law`
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// Even spacing on an ellipse.
    Ring,
    /// Together inside an ellipse, in no fixed places.
    Flock,
    /// Olfati-Saber 2006, algorithm 2.
    OlfatiSaber,
    /// Vásárhelyi et al. 2018.
    Vasarhelyi,
    /// Slots that turn with the ranks.
    VirtualStructure,
    /// Slots by displacements to neighbours.
    DisplacementConsensus,
    /// Another program.
    External,
    /// None of Skein's.
    #[serde(untagged)]
    Own(OwnLaw),
}

/// Skein's laws as a file spells them.
pub(super) const NAMES: &[&str] =
    &["ring", "flock", "olfati-saber", "vasarhelyi", "virtual-structure", "displacement-consensus", "external"];

impl Law {
    /// Vehicles fly together inside R*, in no fixed places.
    pub fn is_flock(self) -> bool {
        matches!(self, Self::Flock | Self::OlfatiSaber | Self::Vasarhelyi)
    }

    /// Every vehicle has a slot of its own.
    pub fn has_slots(self) -> bool {
        matches!(self, Self::VirtualStructure | Self::DisplacementConsensus)
    }

    /// As a file spells it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ring => "ring",
            Self::Flock => "flock",
            Self::OlfatiSaber => "olfati-saber",
            Self::Vasarhelyi => "vasarhelyi",
            Self::VirtualStructure => "virtual-structure",
            Self::DisplacementConsensus => "displacement-consensus",
            Self::External => "external",
            Self::Own(OwnLaw(name)) => name,
        }
    }
}

/// The name of a law that is none of Skein's. There are only those that [`add_laws`] has added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OwnLaw(&'static str);

impl<'de> Deserialize<'de> for OwnLaw {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let known = added().iter().find(|known| **known == name);
        known.copied().map(Self).ok_or_else(|| D::Error::custom(format!("no law is called \"{name}\"")))
    }
}

/// What a program brings along never changes while it runs: like its code, it is no input of a flight.
static ADDED: OnceLock<Vec<&'static str>> = OnceLock::new();

/// Names that `formation.law` takes from now on besides those of Skein, for the whole program. Once at most, before the
/// first scenario is read.
///
/// # Errors
/// A name that is taken, that is none (1 to 64 letters, digits, '-' or '_'), or names that come a second time.
pub fn add_laws(names: Vec<&'static str>) -> Result<(), LawName> {
    check(&names)?;
    ADDED.set(names).map_err(|_| LawName::Late)
}

/// Each a name, and nobody else's.
fn check(names: &[&'static str]) -> Result<(), LawName> {
    for (place, name) in names.iter().enumerate() {
        if crate::id::SwarmName::new(*name).is_err() {
            return Err(LawName::Misspelt(name));
        }
        if NAMES.contains(name) || names[..place].contains(name) {
            return Err(LawName::Taken(name));
        }
    }
    Ok(())
}

/// Why names of laws were not added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LawName {
    /// No name.
    #[error("a law's name has 1 to 64 letters, digits, '-' or '_'; {0:?} has not")]
    Misspelt(&'static str),
    /// Somebody else's.
    #[error("there is a law called {0:?} already")]
    Taken(&'static str),
    /// Not the first.
    #[error("a program adds its laws once")]
    Late,
}

fn added() -> &'static [&'static str] {
    ADDED.get().map_or(&[], Vec::as_slice)
}

/// Every name that `formation.law` takes.
pub(super) fn names() -> impl Iterator<Item = &'static str> + Clone {
    NAMES.iter().chain(added()).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_is_its_name() {
        for name in NAMES {
            let law: Law = toml::Value::from(*name).try_into().unwrap();
            assert_eq!((law.name(), toml::Value::try_from(law).unwrap().as_str()), (*name, Some(*name)));
        }
    }

    // What is added stays for all other tests of this process: that is left to a program of its own.
    #[test]
    fn names_that_are_added_are_free_names() {
        assert_eq!(check(&["my law"]), Err(LawName::Misspelt("my law")));
        assert_eq!(check(&["mine", "ring"]), Err(LawName::Taken("ring")));
        assert_eq!(check(&["mine", "mine"]), Err(LawName::Taken("mine")));
        assert_eq!(check(&["mine", "my-pursuit"]), Ok(()));
        assert!(toml::Value::from("mine").try_into::<Law>().is_err());
    }
}
