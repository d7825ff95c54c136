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

/// A function that limits a number to this range.
macro_rules! within {
    ($least:expr, $most:expr) => {
        |value| value.clamp($least, $most)
    };
}

/// True, 1, of any number but 0.
const IS_TRUE: fn(f32) -> f32 = |value| f32::from(value != 0.0);

macro_rules! settings {
    ($($setting:ident: $initial:expr, $stored:expr;)*) => {
        /// A dataref that can be written and keeps its value.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub(in crate::plant::xplane) enum Setting {
            $($setting,)*
        }

        /// The values of all settings at the start: a helicopter with a running engine, the collective down and free controls.
        const INITIAL: &[f32] = &[$($initial,)*];

        impl Setting {
            /// The number that X-Plane stores when this one is written.
            fn stored_value(self, value: f32) -> f32 {
                let stored: fn(f32) -> f32 = match self {
                    $(Self::$setting => $stored,)*
                };
                stored(value)
            }
        }
    };
}

// Each setting with its value at the start, and with what is stored of a number that is written.
settings! {
    OverrideJoystick: 0.0, f32::trunc;
    OverrideRoll: 0.0, f32::trunc;
    OverridePitch: 0.0, f32::trunc;
    OverrideYaw: 0.0, f32::trunc;
    OverridePlanePath: 0.0, f32::trunc;
    Roll: 0.0, within!(-1.0, 1.0);
    Pitch: 0.0, within!(-1.0, 1.0);
    Yaw: 0.0, within!(-1.0, 1.0);
    Collective: 0.0, within!(0.0, 1.0);
    Stick: 0.0, within!(-1.0, 1.0);
    Throttle: 1.0, within!(0.0, 1.0);
    Governor: 1.0, f32::trunc;
    DataRate: 20.0, |value| value.trunc().clamp(1.0, 99.0);
    RandomFailures: 0.0, f32::trunc;
    Speed: 1.0, within!(0.05, 16.0);
    LocalTime: NOON_S, within!(0.0, SECONDS_OF_A_DAY);
    LocalDate: MIDSUMMER, |value| value.trunc().clamp(0.0, 365.0);
    Payload: 0.0, within!(0.0, 1e6);
    Fuel: 0.0, within!(0.0, 1e6);
    // An order to lose no more datagrams must arrive.
    DropShare: 0.0, within!(0.0, 0.95);
    Freeze: 0.0, within!(0.0, 60.0);
    Restart: 0.0, within!(0.0, 60.0);
    LoadTime: LOADS_FOR_S, within!(0.0, 60.0);
    Replay: 0.0, IS_TRUE;
    Crash: 0.0, IS_TRUE;
    MoveOrigin: 0.0, IS_TRUE;
    ChangeMode: 0.0, |value| value.trunc().clamp(0.0, 7.0);
    UpdateImmediately: 0.0, IS_TRUE;
    Variability: 0.0, within!(0.0, 1.0);
    LayerAltitude: 0.0, within!(-500.0, 60_000.0);
    LayerSpeed: 0.0, within!(0.0, 100.0);
    LayerFrom: 0.0, |value| value.rem_euclid(360.0);
    LayerTurbulence: 0.0, within!(0.0, 10.0);
    LayerShear: 0.0, within!(0.0, 100.0);
    RealWeather: 0.0, IS_TRUE;
    LayerAltitude11: 0.0, within!(-500.0, 60_000.0);
    LayerSpeed11: 0.0, within!(0.0, 200.0);
    LayerFrom11: 0.0, |value| value.rem_euclid(360.0);
    LayerTurbulence11: 0.0, within!(0.0, 10.0);
    LayerShear11: 0.0, within!(0.0, 200.0);
}

/// Values of all settings, element by element.
#[derive(Clone, Debug)]
pub(super) struct Settings([[f32; ELEMENTS]; INITIAL.len()]);

impl Settings {
    /// The settings at the start.
    pub(super) fn new() -> Self {
        Self(std::array::from_fn(|setting| [INITIAL[setting]; ELEMENTS]))
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
