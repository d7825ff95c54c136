//! Options of a stand-in and their checks.

use std::io;
use std::net::SocketAddr;
use std::ops::RangeInclusive;
use std::path::PathBuf;

use serde::Deserialize;
use skein_common::frame::Geodetic;
use skein_common::id::VehicleId;
use skein_core::helicopter::{ParameterError, Parameters, Weather};
use skein_host::files::{self, FileError};

use crate::plant::xplane::server::{DEFAULT_ACF, Version};
use crate::plant::xplane::wire;

/// Distance between the ports of neighbouring vehicles on one computer.
const PORT_STEP: u16 = 10;
/// The default aircraft file.
const XCELL60: &str = include_str!("../../../../../deploy/aircraft/xcell60.toml");

/// Command-line options of a stand-in.
#[derive(Clone, Debug, PartialEq, clap::Args)]
pub struct StandinOptions {
    /// UDP port of vehicle 1; vehicle i listens on PORT + 10·(i − 1). With 0 the system chooses
    #[arg(long, default_value_t = wire::PORT)]
    pub port: u16,
    /// The vehicle's number, 1 to 250
    #[arg(long, default_value = "1")]
    pub id: VehicleId,
    /// Latitude of its start, degrees
    #[arg(long = "lat", default_value_t = 28.0, allow_negative_numbers = true)]
    pub lat_deg: f64,
    /// Longitude of its start, degrees
    #[arg(long = "lon", default_value_t = -82.0, allow_negative_numbers = true)]
    pub lon_deg: f64,
    /// Height of the ground, metres above sea level
    #[arg(long = "alt", default_value_t = 0.0, allow_negative_numbers = true)]
    pub alt_m: f64,
    /// Heading at its start, degrees clockwise from true north
    #[arg(long = "heading", default_value_t = 0.0, allow_negative_numbers = true)]
    pub heading_deg: f64,
    /// The X-Plane to behave like
    #[arg(long, value_enum, default_value = "12")]
    pub version: Version,
    /// Frames a second, 1 to 200; below 19 simulated time is slower than real time, as in X-Plane
    #[arg(long, default_value_t = 50)]
    pub rate: u32,
    /// Largest deviation of a frame's length from its mean, as a share of it, 0 to 0.9
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub jitter: f64,
    /// Share of datagrams, of both directions, that are lost, 0 to 0.95
    #[arg(long, value_name = "SHARE", default_value_t = 0.0)]
    pub drop: f64,
    /// The aircraft file that clients read as loaded
    #[arg(long, value_name = "PATH", default_value = DEFAULT_ACF)]
    pub acf: String,
    /// TCP port of the Web API of vehicle 1, on this computer only, which is 8086 in X-Plane; vehicle i has
    /// PORT + 10·(i − 1). With 0 the system chooses; `off` for none. X-Plane 11 has none
    #[arg(long, value_name = "PORT", default_value = "off")]
    pub web: WebPort,
    /// Whether incoming connections are accepted, as X-Plane's setting of that name: if not, datagrams are ignored and
    /// the Web API refuses requests with 403
    #[arg(long, default_value_t = true, action = clap::ArgAction::Set)]
    pub incoming: bool,
    /// Whether to announce itself by multicast on this computer
    #[arg(long, default_value_t = true, action = clap::ArgAction::Set)]
    pub beacon: bool,
    /// Send values from one port and positions from another, because X-Plane does not document its sending port
    #[arg(long)]
    pub split_ports: bool,
    /// End when standard input is closed and there has been no subscriber for five seconds
    #[arg(long, hide = true)]
    pub until_unused: bool,
    /// Seed of the gusts
    #[arg(long, default_value_t = 1, hide = true)]
    pub seed: u64,
    /// Mean wind speed, m/s
    #[arg(long, default_value_t = 0.0, hide = true)]
    pub wind_m_s: f64,
    /// Direction that the mean wind comes from, degrees clockwise from true north
    #[arg(long, default_value_t = 0.0, allow_negative_numbers = true, hide = true)]
    pub wind_from_deg: f64,
    /// Wind speed 20 ft above the ground that sets the strength of the gusts, m/s
    #[arg(long, default_value_t = 0.0, hide = true)]
    pub gust_w20_m_s: f64,
    /// An aircraft file, for its `[helicopter]` table
    #[arg(long, hide = true)]
    pub aircraft: Option<PathBuf>,
}

/// First TCP port of the Web API, if there is one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WebPort(pub Option<u16>);

impl std::str::FromStr for WebPort {
    type Err = String;
    fn from_str(text: &str) -> Result<Self, String> {
        match (text, text.parse()) {
            ("off", _) => Ok(Self(None)),
            (_, Ok(port)) => Ok(Self(Some(port))),
            _ => Err("has to be a port or off".to_owned()),
        }
    }
}

/// The reason why a stand-in cannot run.
#[derive(Debug, thiserror::Error)]
pub enum StandinError {
    /// The port is in use, most often by a simulator.
    #[error("cannot listen on UDP {0}: {1}; another program may have this port: choose another with --port")]
    Bind(SocketAddr, #[source] io::Error),
    /// The port of the Web API is in use.
    #[error("cannot listen on TCP port {0}: {1}; choose another with --web, or --web off")]
    Web(u16, #[source] io::Error),
    /// An option is outside its range.
    #[error("--{option} {value}: must be {rule}")]
    Option {
        /// Name of the option.
        option: &'static str,
        /// Value given.
        value: String,
        /// Permitted values.
        rule: &'static str,
    },
    /// The aircraft file cannot be read.
    #[error(transparent)]
    Read(#[from] FileError),
    /// The aircraft file has no valid `[helicopter]` table.
    #[error("the aircraft file has no usable [helicopter] table: {0}")]
    Aircraft(toml::de::Error),
    /// A parameter of the aircraft is outside its range.
    #[error("the aircraft file: {0}")]
    Parameters(ParameterError),
}

fn refuse(option: &'static str, value: impl ToString, rule: &'static str) -> StandinError {
    StandinError::Option { option, value: value.to_string(), rule }
}

/// Refuses the first of these options that is outside its range; the last text describes the range.
fn check<const N: usize>(
    options: [(&'static str, f64, RangeInclusive<f64>, &'static str); N],
) -> Result<(), StandinError> {
    match options.into_iter().find(|(_, value, range, _)| !range.contains(value)) {
        Some((option, value, _, rule)) => Err(refuse(option, value, rule)),
        None => Ok(()),
    }
}

const SHARE: &str = "a share: 0 to 0.9 of jitter, 0 to 0.95 of lost datagrams";
const CIRCLE: &str = "within a circle, in degrees";

pub(super) fn check_frames(options: &StandinOptions) -> Result<(), StandinError> {
    check([
        ("rate", options.rate.into(), 1.0..=200.0, "1 to 200"),
        ("jitter", options.jitter, 0.0..=0.9, SHARE),
        ("drop", options.drop, 0.0..=0.95, SHARE),
    ])?;
    if !options.acf.is_ascii() || options.acf.len() > 511 {
        return Err(refuse("acf", &options.acf, "at most 511 ASCII characters"));
    }
    Ok(())
}

/// Port of the Web API, if there is one.
pub(super) fn web_port(options: &StandinOptions) -> Result<Option<u16>, StandinError> {
    match (options.version, options.web) {
        (Version::V12, WebPort(Some(first))) => port_of("web", first, options.id).map(Some),
        _ => Ok(None),
    }
}

pub(super) fn port_of(option: &'static str, first: u16, id: VehicleId) -> Result<u16, StandinError> {
    if first == 0 {
        return Ok(0);
    }
    let offset = PORT_STEP * u16::from(id.get() - 1);
    first.checked_add(offset).ok_or_else(|| refuse(option, first, "small enough for PORT + 10·(id − 1) to be a port"))
}

pub(super) fn start(options: &StandinOptions) -> Result<(Geodetic, f64), StandinError> {
    let place = Geodetic::from_degrees(options.lat_deg, options.lon_deg, options.alt_m);
    check([
        ("lat", options.lat_deg, -90.0..=90.0, CIRCLE),
        ("lon", options.lon_deg, -180.0..=180.0, CIRCLE),
        ("heading", options.heading_deg, -360.0..=360.0, CIRCLE),
    ])?;
    if !place.is_plausible() {
        return Err(refuse("alt", options.alt_m, "a height of the ground in metres"));
    }
    Ok((place, options.heading_deg.to_radians()))
}

pub(super) fn weather(options: &StandinOptions) -> Result<Weather, StandinError> {
    check([
        ("wind-m-s", options.wind_m_s, 0.0..=100.0, "0 to 100"),
        ("gust-w20-m-s", options.gust_w20_m_s, 0.0..=100.0, "0 to 100"),
        ("wind-from-deg", options.wind_from_deg, -360.0..=360.0, CIRCLE),
    ])?;
    Ok(Weather {
        wind_m_s: options.wind_m_s,
        wind_from_rad: options.wind_from_deg.to_radians(),
        gust_w20_m_s: options.gust_w20_m_s,
    })
}

pub(super) fn parameters(options: &StandinOptions) -> Result<Parameters, StandinError> {
    #[derive(Deserialize)]
    struct AircraftFile {
        helicopter: Parameters,
    }
    let text = match &options.aircraft {
        Some(path) => &files::read(path)?,
        None => XCELL60,
    };
    let AircraftFile { helicopter } = toml::from_str(text).map_err(StandinError::Aircraft)?;
    helicopter.check().map_err(StandinError::Parameters)?;
    Ok(helicopter)
}
