//! The values that clients can write, as the stand-in keeps them.

/// Number of elements of a per-engine array since X-Plane 12; X-Plane 11 has eight.
pub(super) const ENGINES: usize = 16;
/// Number of X-Plane's aircraft, the user's own included.
pub(super) const AIRCRAFT: usize = 20;
/// Number of elements that are kept of each setting: those of the longest array.
const ELEMENTS: usize = AIRCRAFT;

/// Time without frames while the user's own aircraft is loaded, s, unless it is ordered otherwise.
const LOADS_FOR_S: f32 = 3.0;

const SECONDS_OF_A_DAY: f32 = 86_400.0;
/// Local time at the start, s: noon; and the date, counted from 0 on the first of January.
pub(super) const NOON_S: f32 = SECONDS_OF_A_DAY / 2.0;
const MIDSUMMER: f32 = 171.0;

/// A dataref that can be written and keeps its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Setting {
    OverrideJoystick,
    OverrideRoll,
    OverridePitch,
    OverrideYaw,
    OverridePlanePath,
    Roll,
    Pitch,
    Yaw,
    Collective,
    Stick,
    Throttle,
    Governor,
    DataRate,
    RandomFailures,
    Speed,
    LocalTime,
    LocalDate,
    Payload,
    Fuel,
    DropShare,
    Freeze,
    Restart,
    LoadTime,
    Replay,
    Crash,
    MoveOrigin,
    ChangeMode,
    UpdateImmediately,
    Variability,
    LayerAltitude,
    LayerSpeed,
    LayerFrom,
    LayerTurbulence,
    LayerShear,
    RealWeather,
    LayerAltitude11,
    LayerSpeed11,
    LayerFrom11,
    LayerTurbulence11,
    LayerShear11,
}

impl Setting {
    const COUNT: usize = Self::LayerShear11 as usize + 1;

    /// The number that X-Plane stores when this one is written.
    fn stored_value(self, value: f32) -> f32 {
        match self {
            // These are integers, so the fraction is cut off.
            Self::OverrideJoystick
            | Self::OverrideRoll
            | Self::OverridePitch
            | Self::OverrideYaw
            | Self::OverridePlanePath
            | Self::Governor
            | Self::RandomFailures => value.trunc(),
            Self::Roll | Self::Pitch | Self::Yaw | Self::Stick => value.clamp(-1.0, 1.0),
            Self::Collective | Self::Throttle => value.clamp(0.0, 1.0),
            Self::DataRate => value.trunc().clamp(1.0, 99.0),
            Self::Speed => value.clamp(0.05, 16.0),
            Self::LocalTime => value.clamp(0.0, SECONDS_OF_A_DAY),
            Self::LocalDate => value.trunc().clamp(0.0, 365.0),
            Self::Payload | Self::Fuel => value.clamp(0.0, 1e6),
            // An order to lose no more datagrams must arrive.
            Self::DropShare => value.clamp(0.0, 0.95),
            Self::Freeze | Self::Restart | Self::LoadTime => value.clamp(0.0, 60.0),
            Self::Replay | Self::Crash | Self::MoveOrigin => f32::from(value != 0.0),
            Self::UpdateImmediately | Self::RealWeather => f32::from(value != 0.0),
            Self::ChangeMode => value.trunc().clamp(0.0, 7.0),
            Self::Variability => value.clamp(0.0, 1.0),
            Self::LayerAltitude | Self::LayerAltitude11 => value.clamp(-500.0, 60_000.0),
            Self::LayerSpeed | Self::LayerShear => value.clamp(0.0, 100.0),
            Self::LayerSpeed11 | Self::LayerShear11 => value.clamp(0.0, 200.0),
            Self::LayerFrom | Self::LayerFrom11 => value.rem_euclid(360.0),
            Self::LayerTurbulence | Self::LayerTurbulence11 => value.clamp(0.0, 10.0),
        }
    }
}

/// Values of all settings, element by element.
#[derive(Clone, Debug)]
pub(super) struct Settings([[f32; ELEMENTS]; Setting::COUNT]);

impl Settings {
    /// A helicopter with a running engine, the collective down and free controls.
    pub(super) fn new() -> Self {
        let mut settings = Self([[0.0; ELEMENTS]; Setting::COUNT]);
        settings.0[Setting::Throttle as usize] = [1.0; ELEMENTS];
        settings.0[Setting::Governor as usize] = [1.0; ELEMENTS];
        settings.0[Setting::DataRate as usize] = [20.0; ELEMENTS];
        settings.0[Setting::Speed as usize] = [1.0; ELEMENTS];
        settings.0[Setting::LocalTime as usize] = [NOON_S; ELEMENTS];
        settings.0[Setting::LocalDate as usize] = [MIDSUMMER; ELEMENTS];
        settings.0[Setting::LoadTime as usize] = [LOADS_FOR_S; ELEMENTS];
        settings
    }

    /// Takes these settings over from another state, all elements.
    pub(super) fn keep(&mut self, old: &Self, kept: &[Setting]) {
        for &setting in kept {
            self.0[setting as usize] = old.0[setting as usize];
        }
    }

    /// Sets all elements.
    pub(super) fn set_all(&mut self, setting: Setting, value: f32) {
        self.0[setting as usize] = [setting.stored_value(value); ELEMENTS];
    }

    /// Value of an element.
    pub(super) fn get(&self, setting: Setting, element: usize) -> f32 {
        self.0[setting as usize][element]
    }

    /// Value of the setting's first element.
    pub(super) fn first(&self, setting: Setting) -> f32 {
        self.0[setting as usize][0]
    }

    pub(super) fn set_first(&mut self, setting: Setting, value: f32) {
        self.0[setting as usize][0] = value;
    }

    /// Stores what a client writes into an element.
    pub(super) fn store(&mut self, setting: Setting, element: usize, value: f32) {
        self.0[setting as usize][element] = setting.stored_value(value);
    }
}
