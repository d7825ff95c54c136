//! What to do when something that the loop needs is missing, ordered by severity.

use crate::estimate::Estimate;

/// Own data older than this are not flown on, s: five frames at 50 Hz.
pub const BLIND_AFTER_S: f64 = 0.1;
/// Own data older than this mean that the simulator is gone, s.
pub const SIMULATOR_LOST_AFTER_S: f64 = 2.0;

/// What the agent does, from the mildest to the most severe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Response {
    /// Everything needed is there.
    FlyOn,
    /// All peers are lost: hold the place.
    HoldPlace,
    /// Own data are stale: cyclic and pedals to trim, collective held.
    Neutral,
    /// The simulator is gone, or was never there: say so, write nothing, wait.
    LetGo,
}

/// The most severe response that applies. `age_s` is the age of the own estimate by the local clock.
pub fn respond(estimate: Option<&Estimate>, age_s: Option<f64>, all_peers_lost: bool) -> Response {
    match (estimate, age_s) {
        (Some(_), Some(age_s)) if age_s <= BLIND_AFTER_S => {
            if all_peers_lost {
                Response::HoldPlace
            } else {
                Response::FlyOn
            }
        }
        (Some(_), Some(age_s)) if age_s <= SIMULATOR_LOST_AFTER_S => Response::Neutral,
        _ => Response::LetGo,
    }
}

#[cfg(test)]
mod tests {
    use skein_common::frame::{Attitude, BodyRates, Geodetic, PositionNed, VelocityNed};

    use super::*;

    #[test]
    fn the_most_severe_response_wins() {
        let estimate = Estimate {
            position: PositionNed::default(),
            geodetic: Geodetic::from_degrees(0.0, 0.0, 0.0),
            height_m: 30.0,
            velocity: VelocityNed::default(),
            attitude: Attitude::default(),
            rates: BodyRates::default(),
            rotor_speed_rad_s: None,
        };
        let table = [
            (Some(0.02), false, Response::FlyOn),
            (Some(0.02), true, Response::HoldPlace),
            (Some(0.3), true, Response::Neutral),
            (Some(2.5), true, Response::LetGo),
        ];
        for (age_s, lost, expected) in table {
            assert_eq!(respond(Some(&estimate), age_s, lost), expected);
        }
        assert_eq!(respond(None, None, false), Response::LetGo, "never heard of the simulator");
        assert!(Response::FlyOn < Response::HoldPlace && Response::Neutral < Response::LetGo);
    }
}
