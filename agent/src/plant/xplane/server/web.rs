//! Carries out the tasks of X-Plane 12's Web API, which the HTTP server hands over to the frame loop.

use std::collections::BTreeSet;

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use serde_json::Value as Json;

use super::datarefs::{DATAREFS, Dataref, Handle, ValueType};
use super::settings::Setting;
use super::{Action, Order, Server};
use crate::plant::xplane::wire::prel::Placement;
use skein_core::helicopter::Weather;

/// The elements wanted of a dataref; `None` is the whole value.
pub type Elements = Option<BTreeSet<usize>>;

/// A new flight, or a change of the current one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Flight {
    /// The start of the aircraft: latitude, longitude and heading, degrees. `None` leaves it where it is.
    pub place_deg: Option<[f64; 3]>,
    /// The weather, if it changes.
    pub weather: Option<Weather>,
    /// All other changes: the local time of day, s, the date, counted from 0 on the first of January, and the weights of payload
    /// and fuel, kg. Of two values the last one counts.
    pub(in crate::plant::xplane) settings: Vec<(Setting, f64)>,
}

/// A request of a client of the Web API to the simulator. Datarefs are the positions in [`DATAREFS`].
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// Read these datarefs, or elements of them.
    Read(Vec<(usize, Elements)>),
    /// Write elements of datarefs: dataref, element, value.
    Write(Vec<(usize, usize, f64)>),
    /// Run a command.
    Run(Action),
    /// Start a flight or change it.
    Fly(Flight),
}

impl Server {
    /// Carries a task out: the values read, and what the caller has to do with the aircraft. `None` before the first
    /// frame, and for a dataref that does not exist.
    pub fn serve(&mut self, task: &Task) -> Option<(Vec<Json>, Vec<Order>)> {
        match task {
            Task::Read(datarefs) => {
                let values = datarefs.iter().map(|(dataref, wanted)| self.value(DATAREFS.get(*dataref)?, wanted));
                Some((values.collect::<Option<_>>()?, Vec::new()))
            }
            Task::Write(writes) => {
                let mut orders = Vec::new();
                for &(dataref, element, value) in writes {
                    let dataref = DATAREFS.get(dataref)?;
                    if element < dataref.elements(self.version.engines()) {
                        let written = Handle { dataref, element }.write(value as f32, &mut self.settings);
                        orders.extend(written.and_then(|setting| self.after_write(setting)));
                    }
                }
                Some((Vec::new(), orders))
            }
            Task::Run(action) => Some((Vec::new(), self.act(*action).into_iter().collect())),
            Task::Fly(flight) => {
                if let Some(weather) = &flight.weather {
                    self.set_weather(weather);
                }
                let place = flight.place_deg.map(|[latitude_deg, longitude_deg, heading_deg]| {
                    self.give_back();
                    Order::Place(Placement {
                        aircraft: 0,
                        latitude_deg,
                        longitude_deg,
                        elevation_m: 0.0,
                        heading_deg,
                        speed_m_s: 0.0,
                    })
                });
                flight.settings.iter().for_each(|(setting, value)| self.settings.store(*setting, 0, *value as f32));
                Some((Vec::new(), place.into_iter().collect()))
            }
        }
    }

    /// Whether a frame has been simulated, so that datarefs have values.
    pub fn has_values(&self) -> bool {
        self.situation.is_some()
    }

    /// The value of a dataref as the Web API shows it: numbers, arrays, and bytes in base64. Of wanted elements it is an array.
    fn value(&self, dataref: &'static Dataref, wanted: &Elements) -> Option<Json> {
        let situation = self.situation.as_ref()?;
        let read = |element| Handle { dataref, element }.read(situation, &self.settings);
        let element = |at| {
            let value = read(at);
            match dataref.value_type {
                ValueType::Double => Json::from(value),
                ValueType::Float | ValueType::FloatArray => f64::from(value as f32).into(),
                ValueType::Int | ValueType::IntArray => (value as i64).into(),
                ValueType::Data => (value as u8).into(),
            }
        };
        let all = 0..dataref.elements(self.version.engines());
        Some(match wanted {
            Some(wanted) => wanted.iter().copied().map(element).collect(),
            None if dataref.value_type == ValueType::Data => {
                STANDARD.encode(all.map(|at| read(at) as u8).collect::<Vec<_>>()).into()
            }
            None if dataref.is_array() => all.map(element).collect(),
            None => element(0),
        })
    }
}
