//! The air: a steady wind, with Dryden gusts in the low-altitude form of MIL-F-8785C.

use rand_chacha::ChaCha8Rng;
use skein_common::frame::VelocityNed;
use skein_common::math;
use skein_common::scenario;

use super::TICK_S;
use crate::random;

/// Wind and turbulence of a scenario.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Weather {
    /// Mean wind speed, m/s.
    pub wind_m_s: f64,
    /// Direction from which the mean wind blows, clockwise from north, rad.
    pub wind_from_rad: f64,
    /// Wind speed W20 at 20 ft above the ground, m/s, which sets the strength of the gusts. Light turbulence is 7.7,
    /// moderate 15.4, severe 23.2; zero gives no gusts.
    pub gust_w20_m_s: f64,
}

impl From<&scenario::World> for Weather {
    fn from(world: &scenario::World) -> Self {
        Self { wind_m_s: world.wind_m_s, wind_from_rad: world.wind_from_rad(), gust_w20_m_s: world.gust_w20_m_s }
    }
}

/// Heights between which the low-altitude form holds, m (the upper one is 1000 ft).
const HEIGHTS_M: (f64, f64) = (3.0, 304.8);
/// Square root of 3.
const SQRT_3: f64 = 1.732_050_807_568_877_2;
const FEET_PER_M: f64 = 1.0 / 0.3048;
/// Lower bound of the mean wind in the gust model, m/s: the mean wind carries frozen gusts past, so a calm would freeze
/// them in place.
const MIN_MEAN_M_S: f64 = 3.0;

/// The air at one vehicle, with its own random generator.
#[derive(Clone, Debug)]
pub struct LocalWind {
    weather: Weather,
    /// North and east components of the direction the mean wind blows to.
    along: (f64, f64),
    gust_along_m_s: f64,
    across: ShapingFilter,
    down: ShapingFilter,
    generator: ChaCha8Rng,
}

impl LocalWind {
    /// Air in which the gusts start at zero; `generator` drives them.
    pub fn new(weather: &Weather, generator: ChaCha8Rng) -> Self {
        Self {
            weather: *weather,
            along: along(weather),
            gust_along_m_s: 0.0,
            across: ShapingFilter::default(),
            down: ShapingFilter::default(),
            generator,
        }
    }

    /// From now on this weather prevails; the gusts continue from where they are.
    pub(super) fn set_weather(&mut self, weather: &Weather) {
        self.weather = *weather;
        self.along = along(weather);
    }

    /// Advances by one tick and returns the velocity of the air at `height_m` above the ground.
    pub fn advance(&mut self, height_m: f64) -> VelocityNed {
        let (along, across, down) = if self.weather.gust_w20_m_s > 0.0 { self.gust(height_m) } else { (0.0, 0.0, 0.0) };
        let along = self.weather.wind_m_s + along;
        let (north, east) = self.along;
        VelocityNed::new(along * north - across * east, along * east + across * north, down)
    }

    /// Gusts along, across (to the right) and down, m/s: per axis white noise n filtered by
    ///
    /// ```text
    /// along:   ġ = −a g + σ_u √(2a) n
    /// across:  ẏ1 = −a y1 + n ;  ẏ2 = −a y2 + y1 ;  g = σ_v √a (√3 y1 + (1 − √3) a y2)      (down: with b, σ_w)
    /// ```
    ///
    /// with a = V/L_u, b = V/L_w.
    fn gust(&mut self, height_m: f64) -> (f64, f64, f64) {
        let spectrum = Spectrum::at(height_m, self.weather.gust_w20_m_s);
        let mean_m_s = self.weather.wind_m_s.abs().max(MIN_MEAN_M_S);
        let (a, b) = (mean_m_s / spectrum.length_horizontal_m, mean_m_s / spectrum.length_vertical_m);
        let (decay, noise) = discrete(a);
        let drive = spectrum.sigma_horizontal_m_s * (2.0 * a).sqrt() * noise;
        self.gust_along_m_s = decay * self.gust_along_m_s + drive * random::standard_normal(&mut self.generator);
        let across = self.across.advance(a, random::standard_normal(&mut self.generator));
        let down = self.down.advance(b, random::standard_normal(&mut self.generator));
        (self.gust_along_m_s, spectrum.sigma_horizontal_m_s * across, spectrum.sigma_vertical_m_s * down)
    }
}

/// North and east components of the direction the mean wind blows to.
fn along(weather: &Weather) -> (f64, f64) {
    let (sin, cos) = math::sin_cos(weather.wind_from_rad);
    (-cos, -sin)
}

/// Strength and length scale of the gusts at one height.
struct Spectrum {
    /// Standard deviation σ_u = σ_v.
    sigma_horizontal_m_s: f64,
    /// Standard deviation σ_w.
    sigma_vertical_m_s: f64,
    /// Length scale L_u = L_v.
    length_horizontal_m: f64,
    /// Length scale L_w.
    length_vertical_m: f64,
}

impl Spectrum {
    /// The spectrum at a height h in feet, with f = 0.177 + 0.000823 h: σ_w = 0.1 W20, σ_u = σ_w/f^0.4, L_u = h/f^1.2,
    /// L_w = h.
    fn at(height_m: f64, w20_m_s: f64) -> Self {
        let height_m = height_m.clamp(HEIGHTS_M.0, HEIGHTS_M.1);
        let f = 0.177 + 0.000823 * (height_m * FEET_PER_M);
        let f_04 = math::exp(0.4 * math::ln(f));
        let sigma_vertical_m_s = 0.1 * w20_m_s;
        Self {
            sigma_horizontal_m_s: sigma_vertical_m_s / f_04,
            sigma_vertical_m_s,
            length_horizontal_m: height_m / (f_04 * f_04 * f_04),
            length_vertical_m: height_m,
        }
    }
}

/// One tick of ẏ = −a y + n as y ← decay · y + noise · N(0, 1): Euler's step, with the noise scaled so that the
/// stationary variance 1/(2a) is exact.
fn discrete(a: f64) -> (f64, f64) {
    let step = (a * TICK_S).min(1.0);
    (1.0 - step, (TICK_S * (1.0 - 0.5 * step)).sqrt())
}

/// Two low-pass filters in series that shape the gusts across and down. The second takes the mean of the first's old
/// and new value, so that the stationary variances of both, and of the gust, are exact.
#[derive(Clone, Copy, Debug, Default)]
struct ShapingFilter {
    y1: f64,
    y2: f64,
}

impl ShapingFilter {
    /// The gust divided by its standard deviation.
    fn advance(&mut self, a: f64, normal: f64) -> f64 {
        let (decay, noise) = discrete(a);
        let y1 = decay * self.y1 + noise * normal;
        self.y2 = decay * self.y2 + 0.5 * TICK_S * (self.y1 + y1);
        self.y1 = y1;
        a.sqrt() * (SQRT_3 * self.y1 + (1.0 - SQRT_3) * a * self.y2)
    }
}

#[cfg(test)]
mod tests;
