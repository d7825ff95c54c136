//! The commands that do something here.

/// The effect of a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Pauses a running simulation, resumes a paused one.
    PauseToggle,
    /// Pauses.
    Pause,
    /// Resumes.
    Resume,
    /// Puts the aircraft back to its start and gives the controls back.
    Reset,
}

/// A command of the simulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandEntry {
    /// Its name.
    pub path: &'static str,
    /// The description that X-Plane shows.
    pub description: &'static str,
    /// Its effect.
    pub action: Action,
}

const fn command(path: &'static str, description: &'static str, action: Action) -> CommandEntry {
    CommandEntry { path, description, action }
}

/// All commands that do something.
pub static COMMANDS: &[CommandEntry] = &[
    command("sim/operation/pause_toggle", "Pause or resume the simulation.", Action::PauseToggle),
    command("sim/operation/pause_on", "Pause the simulation.", Action::Pause),
    command("sim/operation/pause_off", "Resume the simulation.", Action::Resume),
    command("sim/operation/reset_flight", "Reset the flight to its most recent start.", Action::Reset),
    command("sim/operation/reset_to_runway", "Reset the flight to the nearest runway.", Action::Reset),
    command("sim/operation/go_to_default", "Reset the flight to the nearest airport.", Action::Reset),
    command("sim/operation/reload_aircraft", "Reload the aircraft and its art.", Action::Reset),
    command("sim/operation/reload_aircraft_no_art", "Reload the aircraft without its art.", Action::Reset),
];
