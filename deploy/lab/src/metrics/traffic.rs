//! The messages that each vehicle of a fleet received in a flight: the table `traffic.csv` in the folder of the run.

use std::fs::File;
use std::io;
use std::path::Path;

use serde::{Deserialize, Serialize};

/// File name of the table in the folder of a run.
pub const TRAFFIC_FILE: &str = "traffic.csv";

/// A row of the table: what was sent to one vehicle, as a mean over the time in which its agent ran. Messages count before
/// loss on the way.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct VehicleTraffic {
    /// The vehicle, `<team>/<id>`.
    pub vehicle: String,
    /// Time over which messages were counted, s.
    pub counted_s: f64,
    /// Links with other agents, and on plain links with observers, when the team's figures ended. A flight in virtual time has none.
    pub links: Option<u32>,
    /// Messages of all kinds and senders, a second.
    pub messages_per_s: f64,
    /// Payload of these messages, bytes a second.
    pub bytes_per_s: f64,
    /// Those of other teams among them, which are received by cells. Live agents do not count them apart.
    pub others_messages_per_s: Option<f64>,
    /// Payload of the messages of other teams, bytes a second.
    pub others_bytes_per_s: Option<f64>,
}

/// The table as text.
pub fn traffic_csv(rows: &[VehicleTraffic]) -> String {
    let mut table = csv::Writer::from_writer(Vec::new());
    // Writing numbers and short texts into memory does not fail.
    let written = rows.iter().all(|row| table.serialize(row).is_ok());
    let bytes = table.into_inner().ok().filter(|_| written).unwrap_or_default();
    String::from_utf8(bytes).unwrap_or_default()
}

/// Reads the table.
///
/// # Errors
/// If the file cannot be read, or is not such a table.
pub fn read_traffic(path: &Path) -> io::Result<Vec<VehicleTraffic>> {
    let mut table = csv::Reader::from_reader(File::open(path)?);
    Ok(table.deserialize().collect::<Result<_, _>>()?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_is_read_back_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(TRAFFIC_FILE);
        let row = |vehicle: &str, links: Option<u32>, others: Option<f64>| VehicleTraffic {
            vehicle: vehicle.to_owned(),
            counted_s: 61.2,
            links,
            messages_per_s: 102.5,
            bytes_per_s: 7000.0,
            others_messages_per_s: others,
            others_bytes_per_s: others,
        };
        let rows = [row("1/1", None, Some(30.25)), row("2/16", Some(15), None)];
        std::fs::write(&path, traffic_csv(&rows)).unwrap();
        assert_eq!(read_traffic(&path).unwrap(), rows);
        std::fs::write(&path, "vehicle,links\n1/1,3\n").unwrap();
        assert!(read_traffic(&path).is_err());
    }
}
