//! What the vehicle does about what is missing or broken: one [`TABLE`], in which the first row that applies wins.
//!
//! Each stage of the loop adds the conditions that it finds to one set, [`Conditions`], and a stage that has to act asks that set
//! for its [`Response`]. Own data are known first, then failures, then the peers, and last the altitude and the quorum. The table
//! is ordered alike where it matters: what a later stage finds never outranks what made an earlier stage act.
//!
//! A landing outranks a hold: so does the operator's order to land. A hold by the table and a hold by order are the same.
//!
//! Four things are answered within the stage that finds them, and change no row: after a jump of the own clock the jump's time
//! never passed ([`crate::agent`]), an impossible measurement is dropped ([`crate::estimate`]), without an external law the
//! fallback law flies ([`crate::formation::external`]), and a number that the controller cannot use leaves the last controls
//! ([`crate::control`]).

use skein_common::message::Failure;

use crate::deadlines::Deadline;

/// One row: while this is so, the vehicle does that, unless a row above it applies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Row {
    /// What is missing or broken.
    pub condition: Condition,
    /// What the vehicle does.
    pub response: Response,
}

/// Every condition once, by descending priority. Without any of them the vehicle flies on.
pub const TABLE: [Row; 11] = [
    row(Condition::SimulatorLost, Response::LetGo),
    row(Condition::OwnDataStale, Response::Neutral),
    row(Condition::FrameLate, Response::KeepControls),
    row(Condition::EngineOut, Response::Autorotate),
    row(Condition::CyclicStuck, Response::LandTurning),
    row(Condition::ServoStuck, Response::Land),
    row(Condition::AltitudeStuck, Response::Land),
    row(Condition::GyroOff, Response::Land),
    row(Condition::PositionFrozen, Response::Land),
    row(Condition::QuorumLost, Response::Hold),
    row(Condition::AllPeersLost, Response::Hold),
];

/// What can be missing or broken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Condition {
    /// Own data are older than [`Deadline::SimulatorLost`] says, or there never were any.
    SimulatorLost,
    /// Own data are older than [`Deadline::OwnDataStale`] says.
    OwnDataStale,
    /// This step has no new measurement, and the last one is not stale yet.
    FrameLate,
    /// The engine gives no power: the rotor slows down.
    EngineOut,
    /// The roll or the pitch servo does not follow.
    CyclicStuck,
    /// A servo does not follow.
    ServoStuck,
    /// The vehicle neither is at its altitude nor comes nearer to it, with no collective left.
    AltitudeStuck,
    /// The yaw gyro is dead.
    GyroOff,
    /// The measured position repeats; it is dead-reckoned.
    PositionFrozen,
    /// No more than half of the roster is in contact, and the scenario asks for more.
    QuorumLost,
    /// Peers were in contact and are all lost, for less than a minute.
    AllPeersLost,
}

/// What the vehicle does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// Flies the mission.
    FlyOn,
    /// Holds its place; on the ground it stays there.
    Hold,
    /// Leaves the swarm and lands where it is.
    Land,
    /// Lands with the pedals at their stop: turning carries the tilt of the stuck axis round.
    LandTurning,
    /// Leaves the swarm and autorotates to the ground.
    Autorotate,
    /// Decides nothing in this step: the plant keeps the last controls.
    KeepControls,
    /// Puts cyclic and pedals to trim and keeps the collective; sends no state.
    Neutral,
    /// Writes no controls and waits for the simulator; the swarm does not wait for the vehicle.
    LetGo,
}

const fn row(condition: Condition, response: Response) -> Row {
    Row { condition, response }
}

/// The conditions that apply at one instant.
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

    /// The response of the first row of the [`TABLE`] that applies.
    pub fn response(self) -> Response {
        let first = TABLE.iter().find(|row| self.contains(row.condition));
        first.map_or(Response::FlyOn, |row| row.response)
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
    /// What is wrong with own data of this age, s; `None` as age before the first. `is_new` if this step has measured them.
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
        for (nth, row) in TABLE.iter().enumerate() {
            let and_below: Conditions = TABLE[nth..].iter().map(|row| row.condition).collect();
            assert_eq!(and_below.response(), row.response, "{:?}", row.condition);
            let others = TABLE[nth + 1..].iter().filter(|other| other.condition == row.condition);
            assert_eq!(others.count(), 0, "{:?} stands twice", row.condition);
        }
        assert_eq!(Conditions::default().response(), Response::FlyOn);
    }

    #[test]
    fn a_worse_failure_has_a_higher_priority() {
        let place = |failure: Failure| TABLE.iter().position(|row| row.condition == failure.into()).unwrap();
        let failures = [Failure::Position, Failure::Gyro, Failure::Altitude, Failure::Servo, Failure::Engine];
        assert!(failures.windows(2).all(|two| two[0] < two[1] && place(two[0]) > place(two[1])));
    }
}
