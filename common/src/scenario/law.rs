//! Names of control laws: those of Skein, and those that a program of the user adds.

use std::sync::OnceLock;

use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};

/// Control law of a formation, `formation.law`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Law {
    /// Even spacing on an ellipse.
    Ring,
    /// A flock inside an ellipse, without fixed places.
    Flock,
    /// Olfati-Saber 2006, algorithm 2.
    OlfatiSaber,
    /// Vásárhelyi et al. 2018.
    Vasarhelyi,
    /// Virtual structure: each vehicle flies in the slot of its rank.
    VirtualStructure,
    /// Displacement consensus: slots by displacements to the neighbours.
    DisplacementConsensus,
    /// A law in another program.
    External,
    /// A law that the user's program added.
    #[serde(untagged)]
    Own(OwnLaw),
}

/// Names of Skein's laws, as a file spells them.
pub(super) const NAMES: &[&str] =
    &["ring", "flock", "olfati-saber", "vasarhelyi", "virtual-structure", "displacement-consensus", "external"];

/// The laws that can be the fallback of an external one.
pub(super) const BUILT_IN: &[&str] = match NAMES.split_last() {
    Some((_external, built_in)) => built_in,
    None => &[],
};

impl Law {
    /// Whether vehicles fly together inside R*, without fixed places.
    pub fn is_flock(self) -> bool {
        matches!(self, Self::Flock | Self::OlfatiSaber | Self::Vasarhelyi)
    }

    /// Whether every vehicle has a slot of its own.
    pub fn has_slots(self) -> bool {
        matches!(self, Self::VirtualStructure | Self::DisplacementConsensus)
    }

    /// Name of the law, as a file spells it.
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

/// Name of a law that the user's program added with [`add_laws`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct OwnLaw(&'static str);

impl<'de> Deserialize<'de> for OwnLaw {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        let known = added().iter().find(|known| **known == name);
        known.copied().map(Self).ok_or_else(|| D::Error::custom(format!("unknown law \"{name}\"")))
    }
}

/// Names of the laws that the program added. They are set once: like the program's code they are not an input of a
/// flight.
static ADDED: OnceLock<Vec<&'static str>> = OnceLock::new();

/// Adds names of laws that `formation.law` accepts besides those of Skein, for the whole program. Call it once at most,
/// before the first scenario is read.
///
/// # Errors
/// If a name is taken or is not 1 to 64 letters, digits, '-' or '_', or on a second call.
pub fn add_laws(names: Vec<&'static str>) -> Result<(), LawNameError> {
    check(&names)?;
    ADDED.set(names).map_err(|_| LawNameError::Late)
}

/// Checks that each name is valid and unique.
fn check(names: &[&'static str]) -> Result<(), LawNameError> {
    for (place, name) in names.iter().enumerate() {
        if crate::id::SwarmName::new(*name).is_err() {
            return Err(LawNameError::Misspelt(name));
        }
        if NAMES.contains(name) || names[..place].contains(name) {
            return Err(LawNameError::Taken(name));
        }
    }
    Ok(())
}

/// Reason why names of laws were not added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LawNameError {
    /// The name has characters that are not allowed, or is too long or empty.
    #[error("the name of a law is 1 to 64 letters, digits, '-' or '_'; {0:?} is not")]
    Misspelt(&'static str),
    /// Another law has this name.
    #[error("the name {0:?} is taken by another law")]
    Taken(&'static str),
    /// Laws were added before.
    #[error("a program can add laws only once")]
    Late,
}

fn added() -> &'static [&'static str] {
    ADDED.get().map_or(&[], Vec::as_slice)
}

/// All names that `formation.law` accepts.
pub(super) fn names() -> impl Iterator<Item = &'static str> + Clone {
    NAMES.iter().chain(added()).copied()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_law_is_serialised_as_its_name() {
        for name in NAMES {
            let law: Law = toml::Value::from(*name).try_into().unwrap();
            assert_eq!((law.name(), toml::Value::try_from(law).unwrap().as_str()), (*name, Some(*name)));
        }
    }

    // Added names would stay for all other tests of this process: a separate program tests `add_laws`.
    #[test]
    fn only_valid_and_free_names_can_be_added() {
        assert_eq!(check(&["my law"]), Err(LawNameError::Misspelt("my law")));
        assert_eq!(check(&["mine", "ring"]), Err(LawNameError::Taken("ring")));
        assert_eq!(check(&["mine", "mine"]), Err(LawNameError::Taken("mine")));
        assert_eq!(check(&["mine", "my-pursuit"]), Ok(()));
        assert!(toml::Value::from("mine").try_into::<Law>().is_err());
    }
}
