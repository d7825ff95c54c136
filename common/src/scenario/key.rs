//! A key of a configuration file: its path, the kind of its value, its defaults and its meaning; and how a table of keys is
//! declared.

use std::fmt;

use crate::id::VehicleId;
use crate::scenario::law;

/// Declares a table of a scenario file: the struct that the program reads, and the key of each field, with the kind of its
/// value, its default and its meaning, which is the field's documentation too. The meaning ends with the reason for the default.
/// `skein files explain` prints it, so it must be clear without the code. A field without a kind is itself a table or a list.
macro_rules! keys {
    ($($(#[$about_table:meta])* pub struct $name:ident at $path:literal {
        $($(#[$about_field:meta])* $field:ident: $type:ty
            $(= $kind:expr, $default:expr, $about:literal $(, $change:ident($($value:expr),*))*)?;)*
    })*) => {$(
        $(#[$about_table])*
        pub struct $name {
            $($(#[$about_field])* $(#[doc = concat!("`", $path, stringify!($field), "`: ", $about, ".")])? pub $field: $type,)*
        }

        impl $name {
            /// The keys of this table.
            pub(in crate::scenario) const KEYS: &'static [$crate::scenario::key::Key] = {
                use $crate::scenario::key::declare::*;
                &[$($(
                    Key::new(concat!($path, stringify!($field)), $kind, $default, $about)$(.$change($($value),*))*,
                )?)*]
            };
        }
    )*};
}
pub(in crate::scenario) use keys;

/// The names with which keys are declared.
pub(in crate::scenario) mod declare {
    pub(in crate::scenario) use super::Key;
    pub(in crate::scenario) use super::Kind::*;
    pub(in crate::scenario) use super::Literal::{
        Bool as flag, Integer as whole, Nothing, Number as number, Required, Same, Text as text, Toml as as_toml,
    };
    use super::{Kind, Range};

    /// A number from `min` to `max`.
    pub(in crate::scenario) const fn from(min: f64, max: f64) -> Kind {
        Number(Range { min, max, min_included: true })
    }

    /// A number from `min` to `max`, or a text.
    pub(in crate::scenario) const fn from_or(choice: &'static str, min: f64, max: f64) -> Kind {
        NumberOr(choice, Range { min, max, min_included: true })
    }

    /// A number above zero, up to `max`.
    pub(in crate::scenario) const fn above_zero(max: f64) -> Kind {
        Number(Range { min: 0.0, max, min_included: false })
    }

    /// A number above zero, up to `max`, or a text.
    pub(in crate::scenario) const fn above_zero_or(choice: &'static str, max: f64) -> Kind {
        NumberOr(choice, Range { min: 0.0, max, min_included: false })
    }
}

/// A key: its path, kind, defaults and meaning.
#[derive(Clone, Copy, Debug)]
pub struct Key {
    /// Path of the key: `N` is an id, `"T/N"` a vehicle of a fleet, `[N]` an index of a list. A step takes the keys of
    /// `formation` too.
    pub path: &'static str,
    /// Kind of the value.
    pub kind: Kind,
    /// Unit of the numbers, if the key's name does not end in it; see [`Key::unit`].
    pub own_unit: Option<&'static str>,
    /// Default of the key.
    pub default: Literal,
    /// Default under `preset = "paper"`, if it differs.
    pub paper: Option<Literal>,
    /// Default under `law = "flock"`, if it differs; it is the same in both presets.
    pub flock: Option<Literal>,
    /// Default that depends on another key.
    pub implied: Option<Implied>,
    /// Meaning of the key and reason for its default, for a reader without knowledge of the code.
    pub about: &'static str,
}

/// A default that applies when another key has a certain text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Implied {
    /// The other key.
    pub by: &'static str,
    /// The text of the other key for which [`Self::value`] is the default.
    pub is: &'static str,
    /// The default in that case.
    pub value: Literal,
}

/// Kind of a key's value.
#[derive(Clone, Copy, Debug)]
pub enum Kind {
    /// A finite number.
    Number(Range),
    /// A finite number or this text.
    NumberOr(&'static str, Range),
    /// A whole number, both ends included.
    Integer(i64, i64),
    /// true or false.
    Bool,
    /// true; the key cannot be set to false.
    True,
    /// One of these texts.
    OneOf(&'static [&'static str]),
    /// The name of a control law.
    Law,
    /// 1 to 64 letters, digits, '-' or '_'.
    Name,
    /// The name of a TOML file, 1 to 64 letters, digits, '-' or '_', with or without its ending.
    TomlName,
    /// A text that is not empty.
    Text,
    /// HOST:PORT after this prefix.
    Address(&'static str),
    /// A list of one text or more.
    Texts,
    /// A vehicle's id.
    Id,
    /// A list of one vehicle id or more.
    Ids,
    /// A list of pairs of vehicle ids, sender and receiver.
    Edges,
    /// A point: north and east, m.
    Point,
    /// A list of one point or more.
    Points,
    /// A line through two points or more; no two in a row are equal.
    Path,
    /// A list of tables; their keys are in [`KEYS`](super::KEYS) with `[N]`.
    Tables,
    /// A table with any keys and any values that JSON can represent.
    Free,
}

impl Kind {
    /// Whether the key takes numbers that measure or count something; an id does neither.
    pub fn has_numbers(self) -> bool {
        matches!(
            self,
            Self::Number(_) | Self::NumberOr(..) | Self::Integer(..) | Self::Point | Self::Points | Self::Path
        )
    }

    /// The range of the numbers, as text.
    pub fn range(self) -> Option<String> {
        match self {
            Self::Number(range) | Self::NumberOr(_, range) => Some(range.to_string()),
            Self::Integer(min, max) => Some(format!("{min} to {max}")),
            Self::Id | Self::Ids | Self::Edges => Some(format!("1 to {}", VehicleId::MAX)),
            Self::Point | Self::Points | Self::Path => Some(COORDINATES_M.to_string()),
            _ => None,
        }
    }

    /// The texts that the key accepts; empty if it accepts any text or none.
    pub fn choices(self) -> Vec<&'static str> {
        match self {
            Self::OneOf(choices) => choices.to_vec(),
            Self::Law => law::names().collect(),
            _ => Vec::new(),
        }
    }
}

/// The kind as text.
impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(_) => f.write_str("number"),
            Self::NumberOr(choice, _) => write!(f, "number or \"{choice}\""),
            Self::Integer(..) => f.write_str("whole number"),
            Self::Bool => f.write_str("true or false"),
            Self::True => f.write_str("true, or left out"),
            Self::OneOf(_) | Self::Law => {
                let choices: Vec<_> = self.choices().into_iter().map(|choice| format!("\"{choice}\"")).collect();
                write!(f, "one of {}", choices.join(", "))
            }
            Self::Name => f.write_str("name of 1 to 64 letters, digits, '-' or '_'"),
            Self::TomlName => f.write_str("name of a TOML file, with or without \".toml\""),
            Self::Text => f.write_str("text"),
            Self::Address(prefix) => write!(f, "address {prefix}HOST:PORT"),
            Self::Texts => f.write_str("list of texts"),
            Self::Id => f.write_str("vehicle id"),
            Self::Ids => f.write_str("list of vehicle ids"),
            Self::Edges => f.write_str("list of pairs of vehicle ids, [[1, 2], [2, 3]]"),
            Self::Point => f.write_str("point [north, east]"),
            Self::Points | Self::Path => f.write_str("list of points, [[north, east], [north, east]]"),
            Self::Tables => f.write_str("list of tables"),
            Self::Free => f.write_str("table with any keys"),
        }
    }
}

/// Range of the coordinates of points, m. At its end the local plane is already 800 m above the ellipsoid.
pub(in crate::scenario) const COORDINATES_M: Range = Range { min: -1e5, max: 1e5, min_included: true };

/// A range of numbers; the upper end is included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Range {
    /// Lower end.
    pub min: f64,
    /// Upper end.
    pub max: f64,
    /// Whether the lower end is included.
    pub min_included: bool,
}

impl Range {
    /// Whether the number is in the range; NaN is not.
    pub fn contains(self, number: f64) -> bool {
        (if self.min_included { self.min <= number } else { self.min < number }) && number <= self.max
    }
}

impl fmt::Display for Range {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.min_included {
            write!(f, "{} to {}", self.min, self.max)
        } else {
            write!(f, "above {}, at most {}", self.min, self.max)
        }
    }
}

/// A default value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Literal {
    /// No default: the key has to be written.
    Required,
    /// No value.
    Nothing,
    /// The value of this other key.
    Same(&'static str),
    /// A number.
    Number(f64),
    /// A whole number.
    Integer(i64),
    /// true or false.
    Bool(bool),
    /// A text.
    Text(&'static str),
    /// Any other value, as TOML.
    Toml(&'static str),
}

/// The value as TOML, or a description of it.
impl fmt::Display for Literal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Required => f.write_str("none: the key is required"),
            Self::Nothing => f.write_str("none"),
            Self::Same(path) => write!(f, "the value of {path}"),
            Self::Number(number) => write!(f, "{number}"),
            Self::Integer(number) => write!(f, "{number}"),
            Self::Bool(truth) => write!(f, "{truth}"),
            Self::Text(text) => write!(f, "{text:?}"),
            Self::Toml(text) => f.write_str(text),
        }
    }
}

/// Units by the endings of keys' names; a longer ending is before the shorter ones that it ends in.
const UNITS: &[(&str, &str)] = &[
    ("bit_s", "bit/s"),
    ("m_s2", "m/s²"),
    ("m_s", "m/s"),
    ("per_s2", "1/s²"),
    ("per_s", "1/s"),
    ("per_m", "1/m"),
    ("deg_s", "°/s"),
    ("m", "m"),
    ("ms", "ms"),
    ("us", "µs"),
    ("s", "s"),
    ("hz", "Hz"),
    ("deg", "°"),
    ("j", "J"),
    ("bytes", "bytes"),
    ("ppm", "ppm"),
];

/// The quantity and the unit of a name such as `radius_m`; the quantity of a name that is a unit, such as `hz`, is empty.
pub fn split_unit(name: &str) -> Option<(&str, &'static str)> {
    UNITS.iter().find_map(|(end, unit)| {
        let rest = name.strip_suffix(*end)?;
        Some((if rest.is_empty() { rest } else { rest.strip_suffix('_')? }, *unit))
    })
}

impl Key {
    /// A key with one default.
    pub const fn new(path: &'static str, kind: Kind, default: Literal, about: &'static str) -> Self {
        Self { path, kind, own_unit: None, default, paper: None, flock: None, implied: None, about }
    }

    /// The same key with this unit.
    pub(in crate::scenario) const fn unit_is(self, unit: &'static str) -> Self {
        Self { own_unit: Some(unit), ..self }
    }

    /// The same key with this default under `preset = "paper"`.
    pub(in crate::scenario) const fn paper(self, value: Literal) -> Self {
        Self { paper: Some(value), ..self }
    }

    /// The same key with this default under `law = "flock"`.
    pub(in crate::scenario) const fn flock(self, value: Literal) -> Self {
        Self { flock: Some(value), ..self }
    }

    /// The same key with this default where the key `by` has the text `is`.
    pub(in crate::scenario) const fn implied(self, by: &'static str, is: &'static str, value: Literal) -> Self {
        Self { implied: Some(Implied { by, is, value }), ..self }
    }

    /// Name of the key: the last part of its path.
    pub fn name(&self) -> &'static str {
        self.path.rsplit('.').next().unwrap_or(self.path)
    }

    /// Unit of the numbers, "1" for pure numbers; `None` for a key without numbers.
    pub fn unit(&self) -> Option<&'static str> {
        let in_name = || split_unit(self.name()).map(|(_, unit)| unit);
        self.own_unit.or_else(in_name).filter(|_| self.kind.has_numbers())
    }
}
