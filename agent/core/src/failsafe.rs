//! The vehicle's responses to missing or broken data and hardware: one [`TABLE`], in which the first applicable row
//! wins.
//!
//! Each stage of the loop adds the conditions it finds to one set, [`Conditions`], and a stage that has to act takes
//! its [`Response`] from that set. The stages find own data first, then failures, then the peers, and last the altitude,
//! the progress and the quorum. The table has the same order where it matters: a condition found by a later stage never outranks one
//! on which an earlier stage has acted.
//!
//! A landing outranks a hold, and so does the operator's order to land. A hold by the table and a hold by order are the
//! same.
//!
//! Four faults are handled by the stage that finds them and change no row: a jump of the own clock is not counted as
//! time ([`crate::agent`]), an impossible measurement is dropped ([`crate::estimate`]), a lost external law is replaced
//! by the fallback law ([`crate::formation::external`]), and a number the controller cannot use leaves the last
//! controls ([`crate::control`]).

use skein_common::message::Failure;

use crate::deadlines::Deadline;

/// Every condition once, by descending priority, with the vehicle's response: it gives the response to the first condition that
/// applies. Without any of them the vehicle flies on.
pub const TABLE: [(Condition, Response); 13] = [
    (Condition::SimulatorStopped, Response::LetGo),
    (Condition::SimulatorLost, Response::LetGo),
    (Condition::OwnDataStale, Response::Neutral),
    (Condition::FrameLate, Response::KeepControls),
    (Condition::EngineOut, Response::Autorotate),
    (Condition::CyclicStuck, Response::LandTurning),
    (Condition::ServoStuck, Response::Land),
    (Condition::AltitudeStuck, Response::Land),
    (Condition::GyroOff, Response::Land),
    (Condition::PositionFrozen, Response::Land),
    (Condition::NoProgress, Response::Land),
    (Condition::QuorumLost, Response::Hold),
    (Condition::AllPeersLost, Response::Hold),
];

/// An item that is missing or broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// The simulator says that it does not simulate the flight: it is paused, shows a replay, or has placed the aircraft
    /// elsewhere.
    SimulatorStopped,
    /// The own data are older than [`Deadline::SimulatorLost`], or were never received.
    SimulatorLost,
    /// The own data are older than [`Deadline::OwnDataStale`].
    OwnDataStale,
    /// This step has no new measurement, but the last one is not stale yet.
    FrameLate,
    /// The engine gives no power: the rotor slows down.
    EngineOut,
    /// The roll or the pitch servo does not follow its command.
    CyclicStuck,
    /// A servo does not follow its command.
    ServoStuck,
    /// The vehicle is off its altitude and comes no nearer, with no collective left.
    AltitudeStuck,
    /// The yaw gyro has failed.
    GyroOff,
    /// The measured position is frozen; the estimator dead-reckons.
    PositionFrozen,
    /// The vehicle comes no nearer to the step that others wait to leave.
    NoProgress,
    /// At most half of the roster is in contact, and the scenario requires more.
    QuorumLost,
    /// The peers that were in contact are all lost, for less than a minute.
    AllPeersLost,
}

/// The vehicle's response to a condition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// The vehicle flies the mission.
    FlyOn,
    /// The vehicle holds its position; on the ground it stays there.
    Hold,
    /// The vehicle leaves the swarm and lands at its position.
    Land,
    /// The vehicle lands with full pedal: yawing turns the tilt of the stuck axis around.
    LandTurning,
    /// The vehicle leaves the swarm and autorotates to the ground.
    Autorotate,
    /// The agent computes no new controls in this step: the plant keeps the last ones.
    KeepControls,
    /// The agent sets cyclic and pedals to trim, keeps the collective and sends no state.
    Neutral,
    /// The agent writes no controls and waits for the simulator; the swarm does not wait for the vehicle.
    LetGo,
}

/// The set of conditions that apply at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Conditions(u16);

impl Conditions {
    /// Adds a condition.
    pub fn insert(&mut self, condition: Condition) {
        self.0 |= 1 << condition as u16;
    }

    /// Whether the condition applies.
    pub fn contains(self, condition: Condition) -> bool {
        self.0 & 1 << condition as u16 != 0
    }

    /// The response of the first applicable row of the [`TABLE`].
    pub fn response(self) -> Response {
        let first = TABLE.iter().find(|(condition, _)| self.contains(*condition));
        first.map_or(Response::FlyOn, |(_, response)| *response)
    }
}

impl Extend<Condition> for Conditions {
    fn extend<T: IntoIterator<Item = Condition>>(&mut self, conditions: T) {
        conditions.into_iter().for_each(|condition| self.insert(condition));
    }
}

impl FromIterator<Condition> for Conditions {
    fn from_iter<T: IntoIterator<Item = Condition>>(conditions: T) -> Self {
        let mut all = Self::default();
        all.extend(conditions);
        all
    }
}

impl Condition {
    /// The condition of own data of this age, s, `None` before the first; `is_new` if this step has a measurement.
    pub fn of_own_data(age_s: Option<f64>, is_new: bool) -> Option<Self> {
        match age_s {
            Some(age_s) if !Deadline::OwnDataStale.is_past(age_s) => (!is_new).then_some(Self::FrameLate),
            Some(age_s) if !Deadline::SimulatorLost.is_past(age_s) => Some(Self::OwnDataStale),
            _ => Some(Self::SimulatorLost),
        }
    }
}

impl From<Failure> for Condition {
    fn from(failure: Failure) -> Self {
        match failure {
            Failure::Place => Self::NoProgress,
            Failure::Position => Self::PositionFrozen,
            Failure::Gyro => Self::GyroOff,
            Failure::Altitude => Self::AltitudeStuck,
            Failure::Servo => Self::ServoStuck,
            Failure::Engine => Self::EngineOut,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_response_to_own_data_follows_from_their_age() {
        let response =
            |age_s, is_new| Condition::of_own_data(age_s, is_new).into_iter().collect::<Conditions>().response();
        let ages = [
            (Some(0.0), true, Response::FlyOn),
            (Some(0.02), false, Response::KeepControls),
            (Some(0.3), false, Response::Neutral),
            (Some(2.5), false, Response::LetGo),
            (None, false, Response::LetGo),
        ];
        for (age_s, is_new, expected) in ages {
            assert_eq!(response(age_s, is_new), expected, "{age_s:?}");
        }
    }

    #[test]
    fn every_condition_has_one_row_and_outranks_the_rows_below() {
        for (nth, (condition, response)) in TABLE.iter().enumerate() {
            let and_below: Conditions = TABLE[nth..].iter().map(|(condition, _)| *condition).collect();
            assert_eq!(and_below.response(), *response, "{condition:?}");
            let others = TABLE[nth + 1..].iter().filter(|(other, _)| other == condition);
            assert_eq!(others.count(), 0, "{condition:?} has two rows");
        }
        assert_eq!(Conditions::default().response(), Response::FlyOn);
    }

    #[test]
    fn a_worse_failure_has_a_higher_priority() {
        let place = |failure: Failure| TABLE.iter().position(|(condition, _)| *condition == failure.into()).unwrap();
        assert!(Failure::ALL.windows(2).all(|two| two[0] < two[1] && place(two[0]) > place(two[1])));
    }
}
