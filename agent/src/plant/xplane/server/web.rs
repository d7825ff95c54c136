//! What X-Plane 12's Web API does with the simulator: the HTTP server hands each task over to the frame loop.

use super::datarefs::{Dataref, Handle, ValueType};
use super::settings::Setting;
use super::{Action, Order, Server};
use crate::plant::xplane::wire::prel::Placement;
use skein_core::helicopter::Weather;

/// Value of a dataref as the Web API shows it.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// A number.
    Number(f64),
    /// All elements of an array.
    Numbers(Vec<f64>),
    /// Bytes.
    Bytes(Vec<u8>),
}

/// A new flight, or a change of the current one.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Flight {
    /// Where the aircraft starts: latitude, longitude and heading, degrees. `None` leaves it where it is.
    pub place_deg: Option<[f64; 3]>,
    /// The weather, if it changes.
    pub weather: Option<Weather>,
    /// The local time of day, s, if it changes.
    pub local_time_s: Option<f64>,
    /// The date, counted from 0 on the first of January, if it changes.
    pub local_date: Option<f64>,
    /// The weight of the payload, kg, if it changes.
    pub payload_kg: Option<f64>,
    /// The weight of the fuel, kg, if it changes.
    pub fuel_kg: Option<f64>,
}

/// What a client of the Web API asks of the simulator. Datarefs are the positions in [`Dataref::all`].
#[derive(Clone, Debug, PartialEq)]
pub enum Task {
    /// Read these datarefs.
    Read(Vec<usize>),
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
    pub fn serve(&mut self, task: &Task) -> Option<(Vec<Value>, Vec<Order>)> {
        match task {
            Task::Read(datarefs) => {
                let values = datarefs.iter().map(|&dataref| self.value(Dataref::all().get(dataref)?));
                Some((values.collect::<Option<_>>()?, Vec::new()))
            }
            Task::Write(writes) => {
                let mut orders = Vec::new();
                for &(dataref, element, value) in writes {
                    let dataref = Dataref::all().get(dataref)?;
                    if element < dataref.elements(self.version.engines()) {
                        let written = Handle::of(dataref, element).write(value as f32, &mut self.settings);
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
                for (setting, value) in [
                    (Setting::LocalTime, flight.local_time_s),
                    (Setting::LocalDate, flight.local_date),
                    (Setting::Payload, flight.payload_kg),
                    (Setting::Fuel, flight.fuel_kg),
                ] {
                    value.into_iter().for_each(|value| self.settings.store(setting, 0, value as f32));
                }
                Some((Vec::new(), place.into_iter().collect()))
            }
        }
    }

    /// Number of elements of a dataref of this version.
    pub fn elements(&self, dataref: &Dataref) -> usize {
        dataref.elements(self.version.engines())
    }

    fn value(&self, dataref: &'static Dataref) -> Option<Value> {
        let situation = self.situation.as_ref()?;
        let read = |element| Handle::of(dataref, element).read(situation, &self.settings);
        let elements = 0..dataref.elements(self.version.engines());
        Some(match dataref.value_type() {
            ValueType::Double => Value::Number(read(0)),
            ValueType::Float => Value::Number((read(0) as f32).into()),
            ValueType::Int => Value::Number(read(0).trunc()),
            ValueType::FloatArray => Value::Numbers(elements.map(|element| (read(element) as f32).into()).collect()),
            ValueType::IntArray => Value::Numbers(elements.map(|element| read(element).trunc()).collect()),
            ValueType::Data => Value::Bytes(elements.map(|element| read(element) as u8).collect()),
        })
    }
}
