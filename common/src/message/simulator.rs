//! The state and the faults of a simulator, as its agent reports them.

use arrayvec::ArrayString;
use serde::{Deserialize, Serialize};

/// The reason why a simulator does not simulate the flight of its vehicle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum Standstill {
    /// It is paused.
    Paused,
    /// It shows a replay.
    InReplay,
    /// The aircraft has crashed.
    Crashed,
    /// The aircraft was placed elsewhere: by a reset, or because it was loaded again.
    Placed,
    /// Another program flies the aircraft.
    Occupied,
    /// It has loaded the aircraft of this path, and the aircraft file is for another one.
    OtherAircraft(ShortText),
}

impl Standstill {
    pub(super) fn is_plausible(self) -> bool {
        !matches!(self, Self::OtherAircraft(path) if !path.is_printable())
    }
}

impl std::fmt::Display for Standstill {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Paused => f.write_str("simulator paused, waits for it"),
            Self::InReplay => f.write_str("simulator in replay, waits for it"),
            Self::Crashed => f.write_str("aircraft crashed, waits for its reset"),
            Self::Placed => f.write_str("aircraft placed elsewhere by its simulator, starts anew"),
            Self::Occupied => f.write_str("another program flies this aircraft, leaves the controls to it"),
            Self::OtherAircraft(path) => {
                write!(f, "simulator has loaded {path}, the aircraft file is for another one, does not fly it")
            }
        }
    }
}

/// A set-up of the simulator that impairs the flight. It is looked for at each start of the simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub enum SimulatorFault {
    /// A dataref of the aircraft file was not answered, so that this control or value is missing.
    NoDataref(ShortText),
    /// Random failures are on.
    RandomFailures,
    /// Random failures are on, as `plant.random_failures` of the scenario wants.
    WantedRandomFailures,
    /// The ground below the vehicle is so many metres above the scenario's origin, below it if negative. The altitudes of the
    /// formation are above the origin.
    GroundOffOrigin(i32),
}

impl SimulatorFault {
    /// Largest number of faults in a health report.
    pub const MAX_COUNT: usize = 16;
    /// Largest difference of ground from an origin that can be reported, m.
    pub const MAX_GROUND_OFF_M: i32 = 20_000;

    /// Whether the scenario asks for it: then it is stated, and no one has to do anything about it.
    pub fn is_wanted(self) -> bool {
        self == Self::WantedRandomFailures
    }

    pub(super) fn is_plausible(self) -> bool {
        match self {
            Self::NoDataref(path) => path.is_printable(),
            Self::GroundOffOrigin(off_m) => off_m.unsigned_abs() <= Self::MAX_GROUND_OFF_M.unsigned_abs(),
            Self::RandomFailures | Self::WantedRandomFailures => true,
        }
    }
}

impl std::fmt::Display for SimulatorFault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NoDataref(path) => {
                write!(f, "simulator does not answer {path}, correct the table [xplane] of the aircraft file")
            }
            Self::RandomFailures => {
                f.write_str("random failures are on in the simulator, turn them off in its failure settings")
            }
            Self::WantedRandomFailures => f.write_str("random failures are on in the simulator, as the scenario wants"),
            Self::GroundOffOrigin(off_m) => {
                let (off_m, side) = (off_m.unsigned_abs(), if *off_m < 0 { "below" } else { "above" });
                write!(
                    f,
                    "ground is {off_m} m {side} the scenario's origin, set origin.elevation_m to that of the ground"
                )
            }
        }
    }
}

/// A text of at most [`Self::MAX_LENGTH`] characters of printable ASCII.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ShortText(#[cfg_attr(feature = "schema", schemars(with = "String"))] ArrayString<96>);

impl ShortText {
    /// Largest length, bytes.
    pub const MAX_LENGTH: usize = 96;
    /// The mark that stands for the part of a text that was cut off.
    const CUT: &str = "...";

    /// Makes a text of another program safe to show: other characters become `?`, and of a longer text the end is kept,
    /// because a path's end is its name.
    pub fn of(text: &str) -> Self {
        let length = text.chars().count();
        let is_cut = length > Self::MAX_LENGTH;
        let skipped = if is_cut { length - Self::MAX_LENGTH + Self::CUT.len() } else { 0 };
        Self::safe(if is_cut { Self::CUT } else { "" }.chars().chain(text.chars().skip(skipped)))
    }

    /// Like [`Self::of`], but of a longer text the beginning is kept, because a sentence begins with what it is about.
    pub fn beginning_of(text: &str) -> Self {
        if text.chars().count() <= Self::MAX_LENGTH {
            return Self::safe(text.chars());
        }
        Self::safe(text.chars().take(Self::MAX_LENGTH - Self::CUT.len()).chain(Self::CUT.chars()))
    }

    /// Keeps as many of these characters as fit, of one byte each.
    fn safe(text: impl Iterator<Item = char>) -> Self {
        let mut short = ArrayString::new();
        text.map(|c| if Self::is_shown(c) { c } else { '?' }).for_each(|c| _ = short.try_push(c));
        Self(short)
    }

    /// The text.
    pub fn as_str(&self) -> &str {
        &self.0
    }

    pub(super) fn is_shown(c: char) -> bool {
        c == ' ' || c.is_ascii_graphic()
    }

    pub(super) fn is_printable(&self) -> bool {
        self.0.chars().all(Self::is_shown)
    }
}

impl std::fmt::Display for ShortText {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.as_str())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_short_text_is_printable_and_keeps_the_end_of_a_longer_one() {
        assert_eq!(ShortText::of("Aircraft/Bell 206/b206.acf").as_str(), "Aircraft/Bell 206/b206.acf");
        assert_eq!(ShortText::of("a\u{1b}[2Jü").as_str(), "a?[2J?");
        assert_eq!(ShortText::of(&"x".repeat(96)).as_str(), "x".repeat(96));
        let long = format!("{}/r22.acf", "é".repeat(400));
        let short = ShortText::of(&long);
        assert!(short.as_str().starts_with("...??") && short.as_str().ends_with("?/r22.acf"), "{short}");
        assert_eq!(short.as_str().len(), ShortText::MAX_LENGTH);
        let beginning = ShortText::beginning_of(&long);
        assert!(beginning.as_str().starts_with("???") && beginning.as_str().ends_with("?..."), "{beginning}");
        assert_eq!((beginning.as_str().len(), ShortText::beginning_of("a\n").as_str()), (96, "a?"));
    }
}
