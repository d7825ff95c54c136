//! The intent stage decides, without a leader, which team of a fleet flies first to a place that several teams want.
//!
//! Teams exchange two kinds of messages: the states of their vehicles, and their operational intents (the term of ASTM
//! F3548-21). An intent names the area that a team occupies and the area that it wants. Every vehicle decides for itself
//! whether the next area of its mission is free. A vehicle whose next area is taken has not reached its step, so that
//! the team's agreement holds the whole team in its present area. A team waits
//!
//! 1. for a team that occupies a part of the wanted area. There is an exception for a team with a larger number that
//!    waits itself: this team does not wait for it if the two want to change places, nor after [`WAIT_LIMIT_S`];
//! 2. for a team with a smaller number that wants a part of the same area.
//!
//! No circle of waiting teams lasts: somewhere along a circle a team waits for one with a larger number. By rule 2 it
//! never does, and by rule 1 only for a limited time. The area must have been free for [`SETTLED_S`], which is longer
//! than a message takes: of two teams that begin to want the same area at the same time, each receives the other's
//! intent before either enters. Where this fails, as when a team receives nothing, the safety filter keeps the vehicles
//! apart.

use alloc::vec::Vec;

use serde::{Deserialize, Serialize};
use skein_common::frame::{Origin, PositionNed};
use skein_common::id::{FleetVehicle, TeamId};
use skein_common::message::{self, Header, MessageOrder};
use skein_common::scenario::{Scenario, Step};
use skein_common::time::LocalTime;

use crate::formation;
use crate::mission::plan::{self, Kind, Leg};

/// Time for which an area must have been free, s.
pub const SETTLED_S: f64 = 2.0;
/// Time after which a team no longer waits for a larger number that itself waits, s.
pub const WAIT_LIMIT_S: f64 = 60.0;
/// Time between two messages without a change, s.
const PERIOD_S: f64 = 1.0;
/// Time for which an intent holds without another message, s.
const HELD_S: f64 = 5.0;
/// Least distance of two areas of different teams, m.
const BETWEEN_M: f64 = 20.0;
/// Difference of altitude from which two areas do not meet, m.
const ABOVE_M: f64 = 20.0;

/// A circular area at one altitude, in the own team's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Area {
    /// Its centre.
    pub centre: PositionNed,
    /// Its radius, m.
    pub radius_m: f64,
}

impl Area {
    /// Whether two teams cannot have these areas at the same time.
    pub fn meets(&self, other: &Self) -> bool {
        let apart_m = self.centre - other.centre;
        let least_m = self.radius_m + other.radius_m + BETWEEN_M;
        apart_m.z.abs() < ABOVE_M && apart_m.xy().norm_squared() < least_m * least_m
    }
}

/// The area that a team occupies, and the one that it wants.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intent {
    /// The area of the step that it flies.
    pub occupied: Area,
    /// The area for which it waits.
    pub wanted: Option<Area>,
}

impl Intent {
    /// The message with this header; `origin` is that of the team's frame.
    pub fn message(&self, header: Header, origin: &Origin) -> message::Intent {
        let area = |area: &Area| message::Area {
            centre: origin.geodetic_from_ned(area.centre),
            radius_m: area.radius_m as f32,
        };
        message::Intent { header, occupied: area(&self.occupied), wanted: self.wanted.as_ref().map(area) }
    }
}

/// An intent as received.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReceivedIntent {
    /// The vehicle that sent it.
    pub id: FleetVehicle,
    /// Its place among the intents of this vehicle.
    pub order: MessageOrder,
    /// The intent, in the own team's frame.
    pub intent: Intent,
    /// Time of arrival by the own clock.
    pub at: LocalTime,
}

impl ReceivedIntent {
    /// The intent that a vehicle of this team sent and that arrived at this time; `origin` is that of the receiver's frame.
    pub fn new(team: TeamId, message: &message::Intent, origin: &Origin, at: LocalTime) -> Self {
        let area = |area: &message::Area| Area {
            centre: origin.ned_from_geodetic(&area.centre),
            radius_m: area.radius_m.into(),
        };
        let intent = Intent { occupied: area(&message.occupied), wanted: message.wanted.as_ref().map(area) };
        let id = FleetVehicle { team, vehicle: message.header.sender };
        Self { id, order: message.header.order(), intent, at }
    }
}

/// A team that waits for an area.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waiting {
    /// Its number.
    pub team: TeamId,
    /// The area that it occupies.
    pub occupied: Area,
    /// The area that it wants.
    pub wanted: Area,
    /// Time for which it has wanted it, s.
    pub for_s: f64,
}

impl Waiting {
    /// Whether the team waits for another team with this intent.
    pub fn waits_for(&self, other: TeamId, intent: &Intent) -> bool {
        let wants = |area: &Area| intent.wanted.is_some_and(|wanted| wanted.meets(area));
        let gives_way =
            self.team < other && intent.wanted.is_some() && (wants(&self.occupied) || self.for_s > WAIT_LIMIT_S);
        let is_taken = intent.occupied.meets(&self.wanted) && !gives_way;
        is_taken || other < self.team && wants(&self.wanted)
    }
}

/// The intent stage of one vehicle.
#[derive(Clone, Debug)]
pub struct Intents {
    team: TeamId,
    /// The area of each step of the mission; `None` for a landing.
    areas: Vec<Option<Area>>,
    /// The newest intent of each stranger, by team and id.
    known: Vec<ReceivedIntent>,
    /// Since when the next area has been wanted, and since when it has been free.
    wanted_since: Option<LocalTime>,
    free_since: Option<LocalTime>,
    /// The last message, and its time.
    sent: Option<(Intent, LocalTime)>,
}

impl Intents {
    /// The stage of a vehicle of this scenario's team; `None` if the swarm is not part of a fleet.
    pub fn new(scenario: &Scenario) -> Option<Self> {
        let team = scenario.team?.id;
        let legs = plan::legs(&scenario.mission);
        let area = |(leg, step): (&Leg, &Step)| {
            let centre_ne_m = match &leg.kind {
                Kind::Path(path) => path.at(path.length_m()).0,
                Kind::Place | Kind::Hold(_) => leg.from_ne_m,
                Kind::Land => return None,
            };
            let centre = PositionNed::new(centre_ne_m.x, centre_ne_m.y, -step.formation.altitude_m);
            Some(Area { centre, radius_m: formation::extent_m(&step.formation, scenario.swarm.vehicles) })
        };
        let areas = legs.iter().zip(&scenario.mission.steps).map(area).collect();
        Some(Self { team, areas, known: Vec::new(), wanted_since: None, free_since: None, sent: None })
    }

    /// Takes the intents received since the last step. A vehicle that waits for no area needs none: each arrives again within
    /// a second, sooner than an area counts as free.
    pub fn receive(&mut self, received: &[ReceivedIntent]) {
        if self.wanted_since.is_none() {
            self.known.clear();
            return;
        }
        for &intent in received {
            match self.known.binary_search_by_key(&intent.id, |known| known.id) {
                Err(place) => self.known.insert(place, intent),
                Ok(place) if self.known[place].order < intent.order => self.known[place] = intent,
                Ok(_) => {}
            }
        }
    }

    /// Whether another team keeps this one from the step after `step`, or may do so. `is_complete` states that this vehicle
    /// has done everything else in its step: only then it wants the next area, and learns whether that is free.
    pub fn is_next_taken(&mut self, now: LocalTime, step: u32, is_complete: bool) -> bool {
        let Some((occupied, wanted)) = self.area(step).zip(self.next_area(step)) else {
            (self.wanted_since, self.free_since) = (None, None);
            return false;
        };
        if !is_complete {
            (self.wanted_since, self.free_since) = (None, None);
            return true;
        }
        self.known.retain(|known| now.seconds_since(known.at) < HELD_S);
        let for_s = now.seconds_since(*self.wanted_since.get_or_insert(now));
        let waiting = Waiting { team: self.team, occupied, wanted, for_s };
        if self.known.iter().any(|known| waiting.waits_for(known.id.team, &known.intent)) {
            self.free_since = None;
        } else {
            self.free_since.get_or_insert(now);
        }
        self.free_since.is_none_or(|since| now.seconds_since(since) < SETTLED_S)
    }

    /// The own intent, when the other teams need it: at a change and once a second.
    pub fn due(&mut self, now: LocalTime, step: u32) -> Option<Intent> {
        let wanted = if self.wanted_since.is_some() { self.next_area(step) } else { None };
        let intent = Intent { occupied: self.area(step)?, wanted };
        let is_due = |(sent, at): (Intent, LocalTime)| sent != intent || now.seconds_since(at) >= PERIOD_S;
        if !self.sent.is_none_or(is_due) {
            return None;
        }
        self.sent = Some((intent, now));
        Some(intent)
    }

    /// The centre of the area that is wanted: the intents of the teams around it matter.
    pub fn wanted(&self, step: u32) -> Option<PositionNed> {
        self.wanted_since.and(self.next_area(step)).map(|area| area.centre)
    }

    fn area(&self, step: u32) -> Option<Area> {
        self.areas.get(step as usize).copied().flatten()
    }

    /// The area of the next step, if it is another one.
    fn next_area(&self, step: u32) -> Option<Area> {
        self.area(step + 1).filter(|next| self.area(step).is_some_and(|area| area != *next))
    }
}

#[cfg(test)]
mod tests {
    use skein_common::id::Incarnation;
    use skein_common::scenario::{Source, load_any};

    use super::*;

    fn area(north_m: f64) -> Area {
        Area { centre: PositionNed::new(north_m, 0.0, -30.0), radius_m: 100.0 }
    }

    fn team(number: u16) -> TeamId {
        TeamId::new(number).unwrap()
    }

    fn waits(own: u16, for_s: f64, other: u16, occupied_m: f64, wanted_m: Option<f64>) -> bool {
        let own = Waiting { team: team(own), occupied: area(0.0), wanted: area(1000.0), for_s };
        own.waits_for(team(other), &Intent { occupied: area(occupied_m), wanted: wanted_m.map(area) })
    }

    #[test]
    fn areas_meet_within_their_radii_and_an_altitude() {
        assert!(area(0.0).meets(&area(219.0)) && !area(0.0).meets(&area(221.0)));
        let above = Area { centre: PositionNed::new(0.0, 0.0, -50.0), ..area(0.0) };
        assert!(!area(0.0).meets(&above));
    }

    #[test]
    fn a_team_waits_for_one_that_is_there_and_for_smaller_numbers_that_want_it() {
        assert!(waits(1, 0.0, 2, 1100.0, None), "occupied");
        assert!(waits(2, 99.0, 1, 1100.0, None), "occupied, however long");
        assert!(waits(2, 0.0, 1, 2000.0, Some(1000.0)), "the smaller number first");
        assert!(!waits(1, 0.0, 2, 2000.0, Some(1000.0)));
        assert!(!waits(2, 0.0, 1, 2000.0, Some(3000.0)) && !waits(2, 0.0, 1, 2000.0, None));
    }

    #[test]
    fn a_larger_number_gives_way_to_change_places_or_after_a_time() {
        assert!(!waits(1, 0.0, 2, 1000.0, Some(0.0)) && waits(2, 0.0, 1, 1000.0, Some(0.0)), "they change places");
        assert!(waits(1, 59.0, 2, 1000.0, Some(2000.0)) && !waits(1, 61.0, 2, 1000.0, Some(2000.0)));
        assert!(waits(2, 61.0, 1, 1000.0, Some(2000.0)));
    }

    fn intents(text: &str) -> Intents {
        let text = alloc::format!("[fleet]\nteams = 2\n[swarm]\nvehicles = 4\n{text}");
        let fleet = load_any(&Source { name: "a.toml", text: &text }, &[]).unwrap();
        Intents::new(&fleet.all()[1].scenario).unwrap()
    }

    fn received(occupied: Area, wanted: Option<Area>, at_s: f64) -> ReceivedIntent {
        let order = MessageOrder { incarnation: Incarnation(1), sequence: (at_s * 1000.0) as u64 };
        let at = LocalTime::from_seconds(at_s);
        ReceivedIntent { id: "1/1".parse().unwrap(), order, intent: Intent { occupied, wanted }, at }
    }

    #[test]
    fn the_next_area_must_have_been_free_for_a_while() {
        let at = LocalTime::from_seconds;
        let mut intents =
            intents("[mission]\nsteps = [{ centre_ne_m = [0, 0] }, { centre_ne_m = [1000, 0] }, { land = true }]");
        assert!(intents.is_next_taken(at(1.0), 0, false), "it has not asked yet");
        assert_eq!(intents.due(at(1.0), 0).unwrap().wanted, None);
        assert!(intents.due(at(1.5), 0).is_none() && intents.due(at(2.0), 0).is_some(), "once a second");
        assert!(intents.is_next_taken(at(2.1), 0, true));
        let wanted = intents.due(at(2.1), 0).unwrap().wanted.unwrap();
        assert_eq!((wanted.centre.north_m(), wanted.radius_m), (1000.0, 120.0), "at once, at a change");
        intents.receive(&[received(area(1100.0), None, 3.0)]);
        assert!(intents.is_next_taken(at(5.0), 0, true));
        assert!(intents.is_next_taken(at(8.5), 0, true), "its intent has ended");
        assert!(!intents.is_next_taken(at(10.6), 0, true));
        assert!(!intents.is_next_taken(at(10.6), 1, true), "a landing needs no area");
    }
}
