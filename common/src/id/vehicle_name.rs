//! Name of a vehicle on command lines, in files and in certificates.

use std::fmt;
use std::str::FromStr;

use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize, Serializer};

use super::{FleetVehicle, InvalidFleetVehicle, TeamId, VehicleId};

/// Name of a vehicle: its id in a swarm that flies alone, `7`, or with its team in a fleet, `3/7`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct VehicleName {
    /// The team; `None` in a swarm that flies alone.
    pub team: Option<TeamId>,
    /// The id in its swarm or team.
    pub vehicle: VehicleId,
}

impl From<VehicleId> for VehicleName {
    fn from(vehicle: VehicleId) -> Self {
        Self { team: None, vehicle }
    }
}

impl From<FleetVehicle> for VehicleName {
    fn from(FleetVehicle { team, vehicle }: FleetVehicle) -> Self {
        Self { team: Some(team), vehicle }
    }
}

impl fmt::Display for VehicleName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.team {
            Some(team) => write!(f, "{team}/{}", self.vehicle),
            None => self.vehicle.fmt(f),
        }
    }
}

impl FromStr for VehicleName {
    type Err = InvalidFleetVehicle;
    fn from_str(text: &str) -> Result<Self, InvalidFleetVehicle> {
        match text.contains('/') {
            true => text.parse::<FleetVehicle>().map(Self::from),
            false => Ok(text.parse::<VehicleId>()?.into()),
        }
    }
}

impl VehicleName {
    /// The name in file names, services' names and certificates, which have no `/` in them: `7`, in a fleet `3-7`.
    pub fn dashed(self) -> String {
        match self.team {
            Some(team) => format!("{team}-{}", self.vehicle),
            None => self.vehicle.to_string(),
        }
    }

    /// The name as a key or a value of a TOML file: `7`, in a fleet `"3/7"`.
    pub fn quoted(self) -> String {
        match self.team {
            Some(_) => format!("\"{self}\""),
            None => self.to_string(),
        }
    }

    /// Parses the form of [`Self::dashed`]; `None` if the text is something else.
    pub fn from_dashed(text: &str) -> Option<Self> {
        let name = text.replacen('-', "/", 1).parse::<Self>().ok()?;
        (name.dashed() == text).then_some(name)
    }
}

/// Writes the number of a vehicle without a team, else the text.
impl Serialize for VehicleName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self.team {
            Some(_) => serializer.collect_str(self),
            None => self.vehicle.serialize(serializer),
        }
    }
}

/// Reads a text, or the number of a vehicle without a team.
impl<'de> Deserialize<'de> for VehicleName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Name;
        impl Visitor<'_> for Name {
            type Value = VehicleName;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a vehicle, such as 7, or \"3/7\" in a fleet")
            }
            fn visit_i64<E: de::Error>(self, number: i64) -> Result<VehicleName, E> {
                self.visit_str(&number.to_string())
            }
            fn visit_u64<E: de::Error>(self, number: u64) -> Result<VehicleName, E> {
                self.visit_str(&number.to_string())
            }
            fn visit_str<E: de::Error>(self, text: &str) -> Result<VehicleName, E> {
                text.parse().map_err(E::custom)
            }
        }
        deserializer.deserialize_any(Name)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_vehicle_has_a_team_in_its_name_only_in_a_fleet() {
        for text in ["7", "3/7", "4096/250"] {
            assert_eq!(text.parse::<VehicleName>().unwrap().to_string(), text);
        }
        for text in ["", "/", "3/", "/7", "0/7", "3/0", "3/7/1", "251", "4097/1", "x"] {
            assert!(text.parse::<VehicleName>().is_err(), "{text:?}");
        }
        let id = VehicleId::new(7).unwrap();
        assert_eq!("7".parse(), Ok(VehicleName::from(id)));
    }

    #[test]
    fn a_name_without_a_slash_is_parsed_back() {
        for (name, dashed) in [("7", "7"), ("3/7", "3-7"), ("4096/250", "4096-250")] {
            let name: VehicleName = name.parse().unwrap();
            assert_eq!((name.dashed().as_str(), VehicleName::from_dashed(dashed)), (dashed, Some(name)));
        }
        for text in ["", "-", "3-", "-7", "3/7", "3-7-1", "03-7", "3-07", "+7", "0-7"] {
            assert_eq!(VehicleName::from_dashed(text), None, "{text:?}");
        }
    }

    #[test]
    fn a_file_names_a_vehicle_by_number_or_text() {
        #[derive(Debug, PartialEq, Serialize, Deserialize)]
        struct File {
            id: VehicleName,
        }
        let read = |text: &str| toml::from_str::<File>(text).map(|file| file.id.to_string());
        assert_eq!(read("id = 7").as_deref(), Ok("7"));
        assert_eq!(read("id = \"3/7\"").as_deref(), Ok("3/7"));
        assert!(read("id = 0").is_err() && read("id = -1").is_err() && read("id = true").is_err());
        for text in ["id = \"3/7\"\n", "id = 7\n"] {
            assert_eq!(toml::to_string(&toml::from_str::<File>(text).unwrap()).as_deref(), Ok(text));
        }
    }
}
