//! Rows of the Data Output screen, both ways, and the weather radar.

use std::collections::BTreeSet;
use std::net::SocketAddr;

use super::Version;
use super::air::{FEET_PER_M, KNOTS_PER_M_S};
use super::clients::Schedule;
use super::datarefs::Situation;
use super::settings::{Setting, Settings};
use crate::plant::xplane::convert::rpm_from_rad_s;
use crate::plant::xplane::wire::radr::{RadarPoint, RadarPoint11};
use crate::plant::xplane::wire::rows::{DATA_OUTPUT, Destination, Row, SELECTIONS, Selection, encode_rows};
use crate::plant::xplane::wire::{Tag, WireError};

/// Highest number of a row. An unknown row once raised an alert on X-Plane's screen; here it is ignored.
const LAST_ROW: i32 = 138;
const MILES_PER_HOUR_PER_KNOT: f64 = 1852.0 / 1609.344;
/// Speed of sound in the standard atmosphere at sea level, m/s.
const SOUND_M_S: f64 = 340.294;

/// The rows that are sent, and their receiver. X-Plane has one receiver for all programs.
#[derive(Debug, Default)]
pub(super) struct Rows {
    selected: BTreeSet<i32>,
    to: Option<SocketAddr>,
    schedule: Schedule,
}

impl Rows {
    /// Takes a selection or a destination; other messages are ignored.
    ///
    /// # Errors
    /// If the message is malformed.
    pub(super) fn handle(&mut self, datagram: &[u8], from: SocketAddr) -> Result<(), WireError> {
        let is = |tags: &[Tag]| tags.iter().any(|tag| datagram.starts_with(tag));
        if is(&SELECTIONS) {
            let Selection { tag, rows } = Selection::decode(datagram)?;
            match &tag {
                b"DSEL" => self.selected.extend(rows.iter().filter(|&&row| (0..=LAST_ROW).contains(&row))),
                b"USEL" => rows.iter().for_each(|row| {
                    self.selected.remove(row);
                }),
                // There is no cockpit.
                _ => {}
            }
        } else if is(&[*b"ISE4", *b"ISE6"]) {
            let Destination { target, address, port, is_on } = Destination::decode(datagram)?;
            // The rows are not sent to another computer.
            let is_theirs = address == from.ip() || address.is_loopback();
            if target == DATA_OUTPUT && is_theirs && port != 0 {
                self.to = is_on.then_some(SocketAddr::new(address, port));
            }
        }
        Ok(())
    }

    /// Encodes the rows that are due in this frame, and says for whom.
    pub(super) fn due(
        &mut self,
        situation: &Situation,
        settings: &Settings,
        version: Version,
        out: &mut Vec<u8>,
    ) -> Option<SocketAddr> {
        let frame_rate_hz = (1.0 / situation.frame_period_s).round() as u32;
        self.schedule.set_rate(settings.first(Setting::DataRate) as u32, frame_rate_hz);
        let to = self.to.filter(|_| self.schedule.is_due(frame_rate_hz))?;
        let rows: Vec<Row> = self.selected.iter().filter_map(|&row| read(row, situation, settings, version)).collect();
        encode_rows(&rows, out).ok().map(|()| to)
    }
}

/// The row's numbers, if this stand-in has any for it. X-Plane 11 orders the rates of row 16 in another way.
pub(super) fn read(index: i32, s: &Situation, settings: &Settings, version: Version) -> Option<Row> {
    let (p, first) = (&s.position, |setting| f64::from(settings.first(setting)));
    let [east, up, south] = [p.velocity_east_m_s, p.velocity_up_m_s, p.velocity_south_m_s].map(f64::from);
    let rates = [p.roll_rate_rad_s, p.pitch_rate_rad_s, p.yaw_rate_rad_s].map(f64::from);
    let knots = super::datarefs::groundspeed_m_s(s) * KNOTS_PER_M_S;
    let (flow, heading_deg) = (s.flow(), f64::from(p.heading_deg));
    let [shown, true_kt] = [flow.equivalent_airspeed_kt(), flow.true_airspeed_kt()];
    let [forward_g, right_g, down_g] = s.specific_force_g;
    let mph = |knots: f64| knots * MILES_PER_HOUR_PER_KNOT;
    let numbers: &[(usize, f64)] = match index {
        0 => {
            let rate_hz = 1.0 / s.frame_period_s;
            &[(0, rate_hz), (1, rate_hz), (3, s.frame_period_s), (6, 1.0), (7, s.speed)]
        }
        1 => &[(0, s.running_s), (1, s.running_s), (2, s.flight_s)],
        3 => &[(0, shown), (1, shown), (2, true_kt), (3, knots), (5, mph(shown)), (6, mph(true_kt)), (7, mph(knots))],
        4 => &[
            (0, flow.true_airspeed_m_s / SOUND_M_S),
            (2, up * FEET_PER_M * 60.0),
            (4, -down_g),
            (5, forward_g),
            (6, right_g),
        ],
        8 => &[(0, first(Setting::Pitch)), (1, first(Setting::Roll)), (2, first(Setting::Yaw))],
        16 => match version {
            Version::V11 => &[(0, rates[1]), (1, rates[0]), (2, rates[2])],
            Version::V12 => &[(0, rates[0].to_degrees()), (1, rates[1].to_degrees()), (2, rates[2].to_degrees())],
        },
        17 => &[(0, p.pitch_deg.into()), (1, p.roll_deg.into()), (2, heading_deg), (3, heading_deg)],
        18 => &[(0, flow.alpha_deg), (1, flow.beta_deg), (2, flow.hpath_deg), (3, flow.vpath_deg), (7, 0.0)],
        19 => &[(0, heading_deg), (1, 0.0)],
        20 => &[
            (0, p.latitude_deg),
            (1, p.longitude_deg),
            (2, p.elevation_m * FEET_PER_M),
            (3, f64::from(p.height_m) * FEET_PER_M),
        ],
        21 => &[(0, s.local_m[0]), (1, s.local_m[1]), (2, s.local_m[2]), (3, east), (4, up), (5, south)],
        25 | 26 => &[(0, first(Setting::Throttle))],
        28 => &[(0, first(Setting::Collective))],
        38 => &[(0, rpm_from_rad_s(s.rotor_speed_rad_s))],
        _ => return None,
    };
    let mut values = [None; 8];
    numbers.iter().for_each(|&(at, number)| values[at] = Some(number as f32));
    Some(Row { index, values })
}

/// Writes the rows that are controls: stick, throttle, collective. Returns whether the collective is among them.
pub(super) fn write(rows: &[Row], settings: &mut Settings) -> bool {
    let mut has_collective = false;
    for Row { index, values } in rows {
        let targets: &[(Setting, usize)] = match index {
            8 => &[(Setting::Pitch, 0), (Setting::Roll, 1), (Setting::Yaw, 2)],
            25 => &[(Setting::Throttle, 0)],
            28 => &[(Setting::Collective, 0)],
            _ => &[],
        };
        for &(setting, at) in targets {
            if let Some(value) = values[at] {
                settings.store(setting, 0, value);
                has_collective |= setting == Setting::Collective;
            }
        }
    }
    has_collective
}

/// The radar's one client. The sky has no clouds.
#[derive(Debug, Default)]
pub(super) struct Radar(Option<(SocketAddr, Schedule)>);

impl Radar {
    /// Subscribes a client, unless there is another one already.
    pub(super) fn subscribe(&mut self, from: SocketAddr, rate_hz: u32, frame_rate_hz: u32) {
        if self.0.is_none_or(|(client, _)| client == from) {
            self.0 = (rate_hz > 0).then(|| (from, Schedule::new(rate_hz, frame_rate_hz)));
        }
    }

    pub(super) fn forget(&mut self, client: SocketAddr) {
        self.0.take_if(|(known, _)| *known == client);
    }

    /// Encodes the point that is due in this frame, that at the aircraft, and says for whom.
    pub(super) fn due(
        &mut self,
        situation: &Situation,
        version: Version,
        frame_rate_hz: u32,
        out: &mut Vec<u8>,
    ) -> Option<SocketAddr> {
        let (client, schedule) = self.0.as_mut()?;
        if !schedule.is_due(frame_rate_hz) {
            return None;
        }
        let longitude_deg = situation.position.longitude_deg as f32;
        let latitude_deg = situation.position.latitude_deg as f32;
        match version {
            Version::V11 => {
                RadarPoint11::encode(&[RadarPoint11 { longitude_deg, latitude_deg, level: 0, height_m: 0.0 }], out);
            }
            Version::V12 => {
                let [base_m, top_m, clouds, precipitation] = [0.0; 4];
                let point = RadarPoint { longitude_deg, latitude_deg, base_m, top_m, clouds, precipitation };
                RadarPoint::encode(&[point], out);
            }
        }
        Some(*client)
    }
}
