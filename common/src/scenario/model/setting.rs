//! A value of a key that is changed in flight.

use std::cmp::Ordering;
use std::fmt;

use serde::{Deserialize, Serialize};

use super::Formation;

/// Defines [`TunableKey`]: for each key its name, path, fastest change per second, and field of [`Formation`].
macro_rules! tunable_keys {
    ($($(#[doc = $doc:literal])+ $name:ident: $path:literal, $rate_per_s:literal, $($field:ident).+;)*) => {
        /// A key that can change in flight.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub enum TunableKey {
            $($(#[doc = $doc])+ #[serde(rename = $path)] $name,)*
        }

        impl TunableKey {
            /// All keys that can change in flight.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];
            /// Their paths.
            pub(in crate::scenario) const PATHS: &'static [&'static str] = &[$($path),*];

            /// Path of the key in a scenario.
            pub fn path(self) -> &'static str {
                match self {
                    $(Self::$name => $path,)*
                }
            }

            /// Fastest change of the value in flight, in the key's unit per second.
            pub fn rate_per_s(self) -> f64 {
                match self {
                    $(Self::$name => $rate_per_s,)*
                }
            }

            /// The value of the key in a formation.
            pub fn value(self, formation: &Formation) -> f64 {
                match self {
                    $(Self::$name => formation.$($field).+,)*
                }
            }

            /// The value of the key in a formation, to change it.
            pub(in crate::scenario) fn field(self, formation: &mut Formation) -> &mut f64 {
                match self {
                    $(Self::$name => &mut formation.$($field).+,)*
                }
            }
        }
    };
}

tunable_keys! {
    /// Radius of the ring, of a flock's area, or of the slots, m.
    Radius: "formation.radius_m", 1.0, radius_m;
    /// Shape of the ellipse.
    Gamma: "formation.gamma", 0.05, gamma;
    /// Width of the band inside the ring, m.
    InnerWidth: "formation.inner_width_m", 1.0, inner_width_m;
    /// Width of the band outside the ring, m.
    OuterWidth: "formation.outer_width_m", 1.0, outer_width_m;
    /// Weight of the field that turns the ring.
    Circulation: "formation.circulation", 0.1, circulation;
    /// Altitude of the formation, m.
    Altitude: "formation.altitude_m", 1.0, altitude_m;
    /// Difference of height between neighbouring ranks, m.
    BandStep: "formation.band_step_m", 0.2, band_step_m;
    /// Gain of the conversion near the place, m.
    Gain: "formation.gain_m", 1.0, gain_m;
    /// Gain of the nonlinear conversion far from the place, m.
    FarGain: "formation.far_gain_m", 2.0, far_gain_m;
    /// Field strength at which the nonlinear conversion changes its gain.
    GainKnee: "formation.gain_knee", 0.05, gain_knee;
    /// Least distance that the safety filter keeps, m.
    SafetyDistance: "formation.safety_distance_m", 0.5, safety_distance_m;
    /// Largest rate at which the safety filter lets two vehicles close in, 1/s.
    SafetyRate: "formation.safety_rate_per_s", 0.1, safety_rate_per_s;
    /// Gain of the differences to the neighbours under `law = "displacement-consensus"`, 1/s.
    ConsensusGain: "formation.displacement_consensus.gain_per_s", 0.05, displacement_consensus.gain_per_s;
    /// Gain towards the own slot under `law = "displacement-consensus"`, 1/s.
    ConsensusGoalGain: "formation.displacement_consensus.goal_gain_per_s", 0.05, displacement_consensus.goal_gain_per_s;
    /// Distance of neighbours in the lattice under `law = "olfati-saber"`, m.
    LatticeDistance: "formation.olfati_saber.distance_m", 0.5, olfati_saber.distance_m;
    /// Largest commanded speed under `law = "olfati-saber"`, m/s.
    LatticeSpeed: "formation.olfati_saber.max_speed_m_s", 0.5, olfati_saber.max_speed_m_s;
    /// Fastest homing speed under `law = "vasarhelyi"`, m/s.
    FlockSpeed: "formation.vasarhelyi.flock_speed_m_s", 0.5, vasarhelyi.flock_speed_m_s;
    /// Range of the repulsion under `law = "vasarhelyi"`, m.
    RepulsionRange: "formation.vasarhelyi.repulsion_range_m", 0.5, vasarhelyi.repulsion_range_m;
}

impl TunableKey {
    /// The key with this path; `None` if it cannot change in flight.
    pub fn find(path: &str) -> Option<Self> {
        Self::ALL.iter().copied().find(|key| key.path() == path)
    }
}

/// A new value of a key in flight.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Setting {
    /// The key.
    pub key: TunableKey,
    /// Its value, in the key's unit.
    pub value: f64,
}

impl Ord for Setting {
    fn cmp(&self, other: &Self) -> Ordering {
        self.key.cmp(&other.key).then(self.value.total_cmp(&other.value))
    }
}

impl PartialOrd for Setting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Setting {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Setting {}

impl fmt::Display for Setting {
    /// `formation.radius_m=80`
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}={}", self.key.path(), self.value)
    }
}
