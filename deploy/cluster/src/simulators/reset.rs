//! Makes a crashed aircraft of an X-Plane ready for another flight.

use std::time::Duration;

use skein_host::clock;
use skein_lab::error::Error;

use super::survey::Surveyor;

/// Dataref that is 1 if the aircraft has crashed.
pub const CRASHED: &str = "sim/flightmodel2/misc/has_crashed";
/// The command that puts the aircraft back to where its flight began.
pub const RESET: &str = "sim/operation/reset_flight";
/// Time limits for the value to arrive, and for a reset to load.
const ANSWER: Duration = Duration::from_secs(2);
const LOADED_WITHIN: Duration = Duration::from_secs(60);
/// Interval between two commands.
const AGAIN: Duration = Duration::from_secs(5);

/// Resets the aircraft of the X-Plane at `HOST:PORT` if it has crashed. An X-Plane that does not answer is left alone.
///
/// # Errors
/// If the aircraft remains crashed.
pub fn reset_if_crashed(address: &str) -> Result<(), Error> {
    let surveyor = Surveyor::open(address)?;
    let until = clock::now() + LOADED_WITHIN;
    let mut next = clock::now();
    while surveyor.survey(&[CRASHED.to_owned()], 0, ANSWER, false)?.value(CRASHED).is_some_and(|value| value != 0.0) {
        if clock::now() >= until {
            return Err(Error::Failed(format!(
                "X-Plane at {address}: its aircraft has crashed, and {RESET} has not reset it within {} s; reset it by hand",
                LOADED_WITHIN.as_secs()
            )));
        }
        if clock::now() >= next {
            surveyor.command(RESET);
            next = clock::now() + AGAIN;
        }
    }
    Ok(())
}
