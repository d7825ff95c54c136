//! The weather that clients write: datarefs of X-Plane 12's region and those of X-Plane 11, as the built-in helicopter's
//! wind and gusts.

use super::settings::{Setting, Settings};
use super::{Server, Version};
use skein_core::helicopter::Weather;

/// X-Plane 12 takes written weather over at this interval, s, unless `update_immediately` is written.
const UPDATE_EVERY_S: u64 = 60;
/// Wind speed W20 of severe turbulence, m/s, which is the top of X-Plane's scale. X-Plane does not say what its scale
/// means in any unit: this is our reading of it.
pub const SEVERE_W20_M_S: f64 = 23.2;
/// Top of X-Plane's scale of turbulence.
pub const MOST_TURBULENT: f64 = 10.0;
const M_S_PER_KNOT: f64 = 1852.0 / 3600.0;

const SETTINGS_12: &[Setting] =
    &[Setting::LayerAltitude, Setting::LayerSpeed, Setting::LayerFrom, Setting::LayerTurbulence, Setting::LayerShear];
const SETTINGS_11: &[Setting] = &[
    Setting::LayerAltitude11,
    Setting::LayerSpeed11,
    Setting::LayerFrom11,
    Setting::LayerTurbulence11,
    Setting::LayerShear11,
    Setting::RealWeather,
];
/// Settings that are weather.
pub(super) const SETTINGS: [&[Setting]; 3] = [&[Setting::ChangeMode, Setting::Variability], SETTINGS_12, SETTINGS_11];

/// Makes the datarefs show this weather.
pub(super) fn show(settings: &mut Settings, weather: &Weather) {
    let turbulence = MOST_TURBULENT * weather.gust_w20_m_s / SEVERE_W20_M_S;
    for (setting, value) in [
        (Setting::LayerSpeed, weather.wind_m_s),
        (Setting::LayerSpeed11, weather.wind_m_s / M_S_PER_KNOT),
        (Setting::LayerFrom, weather.wind_from_rad.to_degrees()),
        (Setting::LayerFrom11, weather.wind_from_rad.to_degrees()),
        (Setting::LayerTurbulence, turbulence),
        (Setting::LayerTurbulence11, turbulence),
    ] {
        settings.set_all(setting, value as f32);
    }
}

impl Server {
    /// Notes that weather has been written, if this setting is weather of this version.
    pub(super) fn weather_written(&mut self, setting: Setting) {
        let at_once = self.frames;
        self.weather_due = match (self.version, setting) {
            (Version::V12, Setting::UpdateImmediately) if self.settings.first(setting) != 0.0 => Some(at_once),
            (Version::V12, setting) if SETTINGS_12.contains(&setting) => {
                self.weather_due.or(Some(at_once + UPDATE_EVERY_S * u64::from(self.frame_rate_hz)))
            }
            (Version::V11, setting) if SETTINGS_11.contains(&setting) => Some(at_once),
            _ => return,
        };
    }

    /// The weather that has been written, when it is time to take it over.
    pub fn take_weather(&mut self) -> Option<Weather> {
        self.weather_due.take_if(|due| *due <= self.frames)?;
        self.settings.set_first(Setting::UpdateImmediately, 0.0);
        let first = |setting| f64::from(self.settings.first(setting));
        let (speed_m_s, from_deg, turbulence) = match self.version {
            Version::V12 => (first(Setting::LayerSpeed), first(Setting::LayerFrom), first(Setting::LayerTurbulence)),
            Version::V11 => (
                first(Setting::LayerSpeed11) * M_S_PER_KNOT,
                first(Setting::LayerFrom11),
                first(Setting::LayerTurbulence11),
            ),
        };
        let weather = Weather {
            wind_m_s: speed_m_s,
            wind_from_rad: from_deg.to_radians(),
            gust_w20_m_s: turbulence / MOST_TURBULENT * SEVERE_W20_M_S,
        };
        self.surroundings.weather = weather;
        Some(weather)
    }

    /// Sets the weather at once.
    pub(super) fn set_weather(&mut self, weather: &Weather) {
        show(&mut self.settings, weather);
        self.weather_due = Some(self.frames);
    }
}
