//! Identity of vehicles, of their agents' restarts, and of the swarm.

mod vehicle_name;

use std::fmt;
use std::num::{NonZeroU8, NonZeroU16};
use std::ops::Range;

use serde::{Deserialize, Serialize};

pub use vehicle_name::VehicleName;

/// Defines a number from 1 to a largest one, with its spelling as text and the error of another number.
macro_rules! number_from_one {
    ($(#[$about:meta])* $name:ident: $inner:ty, $nonzero:ty, to $max:literal; $(#[$about_error:meta])* $error:ident) => {
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        $(#[$about])*
        pub struct $name($nonzero);

        #[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
        $(#[$about_error])*
        pub struct $error(pub u64);

        impl $name {
            /// The largest number.
            pub const MAX: $inner = $max;

            /// Makes it from its number.
            ///
            /// # Errors
            /// If the number is 0 or above [`Self::MAX`].
            pub fn new(number: $inner) -> Result<Self, $error> {
                match <$nonzero>::new(number) {
                    Some(id) if number <= Self::MAX => Ok(Self(id)),
                    _ => Err($error(number.into())),
                }
            }

            /// Those from 1 to `count` in order, at most [`Self::MAX`] of them.
            pub fn first(count: usize) -> impl Iterator<Item = Self> + Clone {
                (1..=count.min(Self::MAX.into()) as $inner).filter_map(<$nonzero>::new).map(Self)
            }

            /// The number.
            #[inline]
            pub const fn get(self) -> $inner {
                self.0.get()
            }
        }

        impl TryFrom<$inner> for $name {
            type Error = $error;
            fn try_from(number: $inner) -> Result<Self, $error> {
                Self::new(number)
            }
        }

        impl From<$name> for $inner {
            fn from(id: $name) -> $inner {
                id.get()
            }
        }

        impl std::str::FromStr for $name {
            type Err = $error;
            fn from_str(text: &str) -> Result<Self, $error> {
                let number: u64 = text.parse().map_err(|_| $error(0))?;
                Self::new(number.try_into().map_err(|_| $error(number))?)
            }
        }

        impl fmt::Display for $name {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(f, "{}", self.0)
            }
        }
    };
}

number_from_one! {
    /// Id of a vehicle, 1 to 250; it is also the vehicle's MAVLink system id. MAVLink reserves the higher ones for ground
    /// stations.
    #[serde(try_from = "u8", into = "u8")]
    VehicleId: u8, NonZeroU8, to 250;
    /// A number that cannot be a vehicle's id.
    #[error("vehicle ids are 1 to 250, not {0}")]
    InvalidVehicleId
}
number_from_one! {
    /// Number of a team in its fleet, 1 to 4096.
    #[serde(try_from = "u16", into = "u16")]
    TeamId: u16, NonZeroU16, to 4096;
    /// A number that cannot be a team's.
    #[error("teams are numbered 1 to 4096, not {0}")]
    InvalidTeamId
}

impl TeamId {
    /// Team 1.
    pub const FIRST: Self = Self(NonZeroU16::MIN);

    /// The seed of this team in a run of the fleet with this seed: the teams of a fleet, and one team in runs with
    /// different seeds, have different ones.
    pub fn seed(self, fleet: u64) -> u64 {
        // The output function of SplitMix64 (Steele, Lea & Flood 2014), without the sign bit: a seed is a TOML integer.
        let mixed = fleet.wrapping_add(u64::from(self.get()).wrapping_mul(0x9e37_79b9_7f4a_7c15));
        let mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        (mixed ^ (mixed >> 31)) >> 1
    }
}

/// A vehicle of a fleet, written `<team>/<vehicle>`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct FleetVehicle {
    /// Its team.
    pub team: TeamId,
    /// Its id in the team.
    pub vehicle: VehicleId,
}

/// A text that does not name a vehicle of a fleet.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidFleetVehicle {
    /// The form is wrong.
    #[error("a vehicle of a fleet is written TEAM/VEHICLE, such as 3/7")]
    Form,
    /// The team's number is wrong.
    #[error(transparent)]
    Team(#[from] InvalidTeamId),
    /// The vehicle's id is wrong.
    #[error(transparent)]
    Vehicle(#[from] InvalidVehicleId),
}

impl std::str::FromStr for FleetVehicle {
    type Err = InvalidFleetVehicle;
    fn from_str(text: &str) -> Result<Self, InvalidFleetVehicle> {
        let (team, vehicle) = text.split_once('/').ok_or(InvalidFleetVehicle::Form)?;
        Ok(Self { team: team.parse()?, vehicle: vehicle.parse()? })
    }
}

impl fmt::Display for FleetVehicle {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.team, self.vehicle)
    }
}

/// A set of vehicles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "[u64; 4]")]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct VehicleSet([u64; 4]);

impl TryFrom<[u64; 4]> for VehicleSet {
    type Error = InvalidVehicleId;
    fn try_from(blocks: [u64; 4]) -> Result<Self, InvalidVehicleId> {
        let beyond = blocks[3] >> (VehicleId::MAX - 192);
        match beyond {
            0 => Ok(Self(blocks)),
            _ => Err(InvalidVehicleId(u64::from(VehicleId::MAX) + u64::from(beyond.trailing_zeros()) + 1)),
        }
    }
}

impl VehicleSet {
    /// Adds a vehicle.
    #[inline]
    pub fn insert(&mut self, id: VehicleId) {
        let (block, bit) = Self::place(id);
        self.0[block] |= bit;
    }

    /// Removes a vehicle.
    #[inline]
    pub fn remove(&mut self, id: VehicleId) {
        let (block, bit) = Self::place(id);
        self.0[block] &= !bit;
    }

    /// Whether the set contains the vehicle.
    #[inline]
    pub fn contains(&self, id: VehicleId) -> bool {
        let (block, bit) = Self::place(id);
        self.0[block] & bit != 0
    }

    /// Number of vehicles.
    #[inline]
    pub fn len(&self) -> usize {
        self.0.iter().map(|block| block.count_ones() as usize).sum()
    }

    /// Whether the set is empty.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.0 == [0; 4]
    }

    /// Adds all vehicles of another set.
    #[inline]
    pub fn extend(&mut self, others: Self) {
        self.0.iter_mut().zip(others.0).for_each(|(block, other)| *block |= other);
    }

    /// Adds or removes a vehicle.
    #[inline]
    pub fn set(&mut self, id: VehicleId, is_in: bool) {
        if is_in { self.insert(id) } else { self.remove(id) }
    }

    /// The vehicles that are in both sets.
    #[inline]
    #[must_use]
    pub fn both(self, other: Self) -> Self {
        Self(std::array::from_fn(|nth| self.0[nth] & other.0[nth]))
    }

    /// The vehicles that are in one of the sets, or in both.
    #[inline]
    #[must_use]
    pub fn either(self, other: Self) -> Self {
        Self(std::array::from_fn(|nth| self.0[nth] | other.0[nth]))
    }

    /// The vehicles that are in this set and not in the other.
    #[inline]
    #[must_use]
    pub fn without(self, other: Self) -> Self {
        Self(std::array::from_fn(|nth| self.0[nth] & !other.0[nth]))
    }

    /// The vehicle with the lowest id.
    #[inline]
    pub fn first(&self) -> Option<VehicleId> {
        self.iter().next()
    }

    /// The vehicle with the lowest id above this one.
    #[inline]
    pub fn first_above(&self, id: VehicleId) -> Option<VehicleId> {
        let (nth, bit) = Self::place(id);
        let mut ids = VehicleIds { blocks: self.0, nth };
        ids.blocks[nth] &= !(bit | (bit - 1));
        ids.next()
    }

    /// Number of vehicles with ids lower than this one.
    #[inline]
    pub fn count_below(&self, id: VehicleId) -> usize {
        let (last, bit) = Self::place(id);
        let whole: u32 = self.0[..last].iter().map(|block| block.count_ones()).sum();
        (whole + (self.0[last] & (bit - 1)).count_ones()) as usize
    }

    /// All vehicles, in the order of their ids.
    #[inline]
    pub fn iter(&self) -> VehicleIds {
        VehicleIds { blocks: self.0, nth: 0 }
    }

    /// The runs of consecutive ids, in their order, each as its range in a table of all vehicles from 1 on.
    pub fn runs(self) -> impl Iterator<Item = Range<usize>> {
        let mut begin = 0;
        std::iter::from_fn(move || {
            let first = self.next_place(begin, true)?;
            begin = self.next_place(first, false)?;
            Some(first..begin)
        })
    }

    /// The first place from this one on whose bit is set, or is not.
    #[inline]
    fn next_place(&self, from: usize, is_set: bool) -> Option<usize> {
        let wanted = |block: u64| if is_set { block } else { !block };
        let mut nth = from / 64;
        let mut block = wanted(*self.0.get(nth)?) & (u64::MAX << (from % 64));
        while block == 0 {
            nth += 1;
            block = wanted(*self.0.get(nth)?);
        }
        Some(64 * nth + block.trailing_zeros() as usize)
    }

    /// One bit for each id from 1 on, the lowest bit of the first byte for vehicle 1.
    pub fn to_bytes(self) -> [u8; 32] {
        let mut bytes = [0; 32];
        bytes.chunks_exact_mut(8).zip(self.0).for_each(|(bytes, block)| bytes.copy_from_slice(&block.to_le_bytes()));
        bytes
    }

    #[inline]
    fn place(id: VehicleId) -> (usize, u64) {
        let index = usize::from(id.get()) - 1;
        (index / 64, 1 << (index % 64))
    }
}

/// The vehicles of a set, in the order of their ids.
#[derive(Clone, Debug)]
pub struct VehicleIds {
    blocks: [u64; 4],
    nth: usize,
}

impl Iterator for VehicleIds {
    type Item = VehicleId;

    #[inline]
    fn next(&mut self) -> Option<VehicleId> {
        while let Some(block) = self.blocks.get_mut(self.nth) {
            if *block != 0 {
                let bit = block.trailing_zeros() as u8;
                // Clears the lowest bit.
                *block &= *block - 1;
                return NonZeroU8::new((self.nth * 64) as u8 + bit + 1).map(VehicleId);
            }
            self.nth += 1;
        }
        None
    }
}

impl FromIterator<VehicleId> for VehicleSet {
    fn from_iter<I: IntoIterator<Item = VehicleId>>(ids: I) -> Self {
        ids.into_iter().fold(Self::default(), |mut set, id| {
            set.insert(id);
            set
        })
    }
}

/// A text that does not list vehicles.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum InvalidVehicleSet {
    /// An id is wrong.
    #[error(transparent)]
    Vehicle(#[from] InvalidVehicleId),
    /// A range ends below its begin.
    #[error("the range {0}-{1} ends below its begin")]
    Range(VehicleId, VehicleId),
}

impl std::str::FromStr for VehicleSet {
    type Err = InvalidVehicleSet;

    /// Reads ids and ranges of ids: `1,3` or `1-3,7`.
    fn from_str(text: &str) -> Result<Self, InvalidVehicleSet> {
        let mut all = Self::default();
        for part in text.split(',').map(str::trim) {
            let (first, last) = part.split_once('-').unwrap_or((part, part));
            let (first, last): (VehicleId, VehicleId) = (first.trim().parse()?, last.trim().parse()?);
            if last < first {
                return Err(InvalidVehicleSet::Range(first, last));
            }
            all.extend(VehicleId::first(last.get().into()).filter(|id| *id >= first).collect());
        }
        Ok(all)
    }
}

impl fmt::Display for VehicleSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.iter().map(|id| id.to_string()).collect::<Vec<_>>().join(", "))
    }
}

/// Number of one run of an agent's process: a restarted agent has a larger one. It is the time of the start (UTC, ns),
/// so that it grows without a file that counts the starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Incarnation(pub u64);

/// Name of a swarm: the Zenoh namespace of all its messages.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct SwarmName(String);

/// A text that cannot be the name of a swarm.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the name of a swarm is 1 to 64 letters, digits, '-' or '_'; {0:?} is not")]
pub struct BadSwarmName(pub String);

impl SwarmName {
    /// Makes a name that is valid in a Zenoh key, a file name and a service name.
    ///
    /// # Errors
    /// If the text is not 1 to 64 ASCII letters, digits, '-' or '_'.
    pub fn new(text: impl Into<String>) -> Result<Self, BadSwarmName> {
        let text = text.into();
        let good = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if (1..=64).contains(&text.len()) && text.chars().all(good) { Ok(Self(text)) } else { Err(BadSwarmName(text)) }
    }

    /// The name as text.
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for SwarmName {
    type Error = BadSwarmName;
    fn try_from(text: String) -> Result<Self, BadSwarmName> {
        Self::new(text)
    }
}

impl From<SwarmName> for String {
    fn from(name: SwarmName) -> String {
        name.0
    }
}

impl fmt::Display for SwarmName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vehicle_ids_are_1_to_250() {
        assert!(VehicleId::new(0).is_err());
        assert!(VehicleId::new(251).is_err());
        assert_eq!("250".parse::<VehicleId>().map(VehicleId::get), Ok(250));
        assert_eq!("300".parse::<VehicleId>(), Err(InvalidVehicleId(300)));
        assert_eq!(VehicleId::first(3).map(VehicleId::get).collect::<Vec<_>>(), [1, 2, 3]);
    }

    #[test]
    fn a_swarm_name_is_valid_in_a_key() {
        assert!(SwarmName::new("lab-1").is_ok());
        for bad in ["", "a/b", "*", "a b", "ä"] {
            assert!(SwarmName::new(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_set_of_vehicles_is_read_from_ids_and_ranges() {
        let set = |text: &str| text.parse::<VehicleSet>().map(|set| set.to_string()).map_err(|why| why.to_string());
        assert_eq!((set("3"), set("1,3")), (Ok("3".to_owned()), Ok("1, 3".to_owned())));
        assert_eq!(set("7, 1-3,2"), Ok("1, 2, 3, 7".to_owned()));
        assert_eq!(set("1-250").map(|text| text.split(',').count()), Ok(250));
        assert_eq!(set("3-1"), Err("the range 3-1 ends below its begin".to_owned()));
        assert_eq!(set("1,251"), Err("vehicle ids are 1 to 250, not 251".to_owned()));
        for bad in ["", ",", "1,", "-3", "1-", "a", "1-2-3"] {
            assert!(set(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn a_set_of_vehicles_contains_exactly_the_inserted_ids() {
        let ids = [1, 2, 64, 65, 128, 129, 200, 250].map(|number| VehicleId::new(number).unwrap());
        let mut set: VehicleSet = ids.into_iter().collect();
        assert_eq!(set.iter().collect::<Vec<_>>(), ids);
        assert!(set.runs().eq([0..2, 63..65, 127..129, 199..200, 249..250]) && VehicleSet::default().runs().eq([]));
        assert_eq!(
            (set.len(), set.contains(ids[3]), set.to_string()),
            (8, true, "1, 2, 64, 65, 128, 129, 200, 250".into())
        );
        set.remove(ids[3]);
        assert!(!set.contains(ids[3]) && set.len() == 7);
        let mut more: VehicleSet = [ids[3]].into_iter().collect();
        more.extend(set);
        assert_eq!(more.iter().collect::<Vec<_>>(), ids);
        assert!(VehicleSet::default().is_empty() && VehicleSet::default().iter().next().is_none());
    }
}
