//! What the network does to what one agent hears: words that are lost, late, doubled or out of order, links that are narrow,
//! cut or too long, and states that are nobody's business.
//!
//! All of it happens at the hearing end, so that the same [`Ear`] makes a study's network and, between Zenoh and the agent,
//! a real one's faults. Chance comes from the scenario's seed.
//!
//! * What a scenario asks for besides a delay, each direction of a link does for itself (`channel`), and so does it what
//!   depends on who is where (`air`).
//! * States, parts in the agreement and orders suffer all of it. Tokens only take the link's `delay_s`: Zenoh repeats them, in
//!   order. An operator's orders have no place, and suffer what `[network]` says of every link.
//! * A cut silences directions of links, and ends sessions as `link.rs` tells.
//! * A delay that an event adds comes last, on top of what the link takes.

mod air;
mod channel;
mod cuts;
mod link;

use alloc::boxed::Box;
use alloc::collections::VecDeque;
use alloc::vec::Vec;
use core::ops::Range;

use skein_common::frame::PositionNed;
use skein_common::id::VehicleId;
use skein_common::message::{MessageOrder, PeerAge, State};
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use crate::peers::{Heard, Word};
use air::Air;
pub use cuts::{delays, lasting, silences, union};
use link::Link;

/// The network as one agent hears it.
#[derive(Clone, Debug)]
pub struct Ear {
    delay_s: f64,
    /// `None` where a delay is all there is, alike everywhere.
    air: Option<Box<Air>>,
    /// Those that are ever cut, by the other end's id.
    links: Vec<Link>,
    delays: AddedDelays,
    /// Since the own take-off, s; `None` before it.
    flown_s: Option<f64>,
    /// What has yet to arrive, the earliest first.
    under_way: VecDeque<UnderWay>,
    /// How late the newest state of each speaker came, by its id.
    lateness: Vec<Late>,
    tally: Tally,
}

/// What events add to the delay of messages from a sender: when, in s after the own take-off, and how much, s.
#[derive(Clone, Debug)]
struct AddedDelays(Vec<(VehicleId, (Range<f64>, f64))>);

/// What the network has to know of the vehicle that hears.
#[derive(Clone, Copy, Debug, Default)]
pub struct Whereabouts {
    /// Since its take-off, s, as the cuts count; `None` before it.
    pub flown_s: Option<f64>,
    /// Where it takes itself to be.
    pub position: Option<PositionNed>,
}

/// What became of all words so far. On a network that does nothing nobody counts.
///
/// Always `said + doubled = unlinked + crowded_out + too_far + lost + cut + heard`, and what is under way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Tally {
    /// Words that came to the network, and what a link that is whole again repeats.
    pub said: u64,
    /// Copies that the network made.
    pub doubled: u64,
    /// States that `network.graph` keeps from this vehicle.
    pub unlinked: u64,
    /// Dropped because they would have waited too long for the bandwidth.
    pub crowded_out: u64,
    /// Lost by distance.
    pub too_far: u64,
    /// Lost by chance.
    pub lost: u64,
    /// Stopped by a cut; the newest may be repeated later.
    pub cut: u64,
    /// Delivered, copies included.
    pub heard: u64,
}

/// What becomes of a word.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fate {
    Unlinked,
    CrowdedOut,
    TooFar,
    Lost,
    Arrives {
        at: LocalTime,
        /// When it comes once more, if it does.
        copy_at: Option<LocalTime>,
    },
}

/// A word on its way.
#[derive(Clone, Copy, Debug)]
struct UnderWay {
    /// With the time of its arrival.
    heard: Heard,
    said_at: LocalTime,
}

/// How late a speaker's newest state came.
#[derive(Clone, Copy, Debug)]
struct Late {
    speaker: VehicleId,
    newest: MessageOrder,
    by_s: f64,
}

impl Ear {
    /// The hearing of vehicle `own` at the beginning of a life.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        let peers = scenario.ids().filter(|&id| id != own);
        let delays = AddedDelays::new(scenario, own, peers.clone());
        Self {
            delay_s: scenario.network.delay_s,
            air: Air::new(scenario, own).map(Box::new),
            delays,
            flown_s: None,
            links: peers.filter_map(|peer| Link::new(scenario, own, peer)).collect(),
            under_way: VecDeque::new(),
            lateness: Vec::new(),
            tally: Tally::default(),
        }
    }

    /// Moves to the end of `out` what is heard by `now`, in the order in which it arrives. `arriving` is what a perfect
    /// network brings, each with the time at which it does.
    pub fn hear(
        &mut self,
        now: LocalTime,
        own: Whereabouts,
        arriving: impl IntoIterator<Item = Heard>,
        out: &mut Vec<Heard>,
    ) {
        if self.is_perfect() {
            out.extend(arriving);
            return;
        }
        if let Some(air) = &mut self.air {
            air.update(now, own.position);
        }
        self.flown_s = own.flown_s;
        self.pass_time(now, own.flown_s);
        for heard in arriving {
            self.tally.said += 1;
            match self.fate(&heard) {
                Fate::Unlinked => self.tally.unlinked += 1,
                Fate::CrowdedOut => self.tally.crowded_out += 1,
                Fate::TooFar => self.tally.too_far += 1,
                Fate::Lost => self.tally.lost += 1,
                Fate::Arrives { .. } if !self.gets_through(&heard) => self.tally.cut += 1,
                Fate::Arrives { at, copy_at } => {
                    let delay_s = heard.word.speaker().map_or(0.0, |sender| self.added_delay_s(sender));
                    send(&mut self.under_way, heard, at.plus_seconds(delay_s));
                    if let Some(copy_at) = copy_at {
                        self.tally.doubled += 1;
                        send(&mut self.under_way, heard, copy_at.plus_seconds(delay_s));
                    }
                }
            }
        }
        self.deliver(now, out);
    }

    /// What became of all words so far.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Words that have yet to arrive.
    pub fn under_way(&self) -> usize {
        self.under_way.len()
    }

    /// Whether the scenario asks for a network that changes nothing.
    pub fn is_perfect(&self) -> bool {
        self.delay_s == 0.0 && self.links.is_empty() && self.delays.0.is_empty() && self.air.is_none()
    }

    /// Writes down how late each peer's newest state was when it was delivered.
    pub fn tell_lateness(&self, peers: &mut [PeerAge]) {
        for peer in peers {
            if let Ok(index) = self.late(peer.id) {
                peer.delivered_age_s = self.lateness[index].by_s;
            }
        }
    }

    /// What links that were cut bring by themselves.
    fn pass_time(&mut self, now: LocalTime, flown_s: Option<f64>) {
        let Self { links, delays, under_way, air, tally, .. } = self;
        let Some(flown_s) = flown_s else { return };
        for link in links {
            let delay_s = air.as_ref().map_or(self.delay_s, |air| air.delay_s(Some(link.peer())))
                + delays.s(Some(flown_s), link.peer());
            link.update(flown_s, now, |heard| {
                tally.said += 1;
                send(under_way, heard, now.plus_seconds(delay_s));
            });
        }
    }

    /// What events add to the delay of messages from this sender now, s.
    fn added_delay_s(&self, sender: VehicleId) -> f64 {
        self.delays.s(self.flown_s, sender)
    }

    fn fate(&mut self, heard: &Heard) -> Fate {
        let is_cut = self.air.is_some() && self.link(&heard.word).is_some_and(|index| self.links[index].is_dead());
        if let Some(air) = &mut self.air {
            return air.fate(heard, is_cut);
        }
        Fate::Arrives { at: heard.at.plus_seconds(self.delay_s), copy_at: None }
    }

    fn gets_through(&mut self, heard: &Heard) -> bool {
        self.link(&heard.word).is_none_or(|index| self.links[index].carries(heard))
    }

    /// Which of those that are ever cut it comes over. An operator is at no end of one.
    fn link(&self, word: &Word) -> Option<usize> {
        self.links.binary_search_by_key(&word.speaker()?, Link::peer).ok()
    }

    fn deliver(&mut self, now: LocalTime, out: &mut Vec<Heard>) {
        while let Some(UnderWay { heard, said_at }) = self.under_way.pop_front_if(|word| word.heard.at <= now) {
            self.tally.heard += 1;
            if let Word::State(said) = &heard.word {
                self.note(said, heard.at.seconds_since(said_at));
            }
            out.push(heard);
        }
    }

    /// How late a state is, if nothing newer was heard.
    fn note(&mut self, said: &State, by_s: f64) {
        let newest = said.header.order();
        let late = Late { speaker: said.header.sender, newest, by_s };
        match self.late(late.speaker) {
            Ok(index) if self.lateness[index].newest < newest => self.lateness[index] = late,
            Ok(_) => {}
            Err(index) => self.lateness.insert(index, late),
        }
    }

    fn late(&self, speaker: VehicleId) -> Result<usize, usize> {
        self.lateness.binary_search_by_key(&speaker, |late| late.speaker)
    }
}

impl AddedDelays {
    /// Of the messages from these senders to vehicle `own`.
    fn new(scenario: &Scenario, own: VehicleId, senders: impl Iterator<Item = VehicleId>) -> Self {
        let of = |sender| delays(&scenario.mission.events, sender, own).into_iter().map(move |delay| (sender, delay));
        Self(senders.flat_map(of).collect())
    }

    /// Added to the delay of messages from this sender now, s.
    fn s(&self, flown_s: Option<f64>, sender: VehicleId) -> f64 {
        let lasts = |lasting: &Range<f64>| flown_s.is_some_and(|t_s| lasting.contains(&t_s));
        let lasting = self.0.iter().filter(|(id, (lasting, _))| *id == sender && lasts(lasting));
        lasting.map(|(_, (_, delay_s))| delay_s).sum()
    }
}

/// Puts a word where its arrival belongs: behind those that arrive no later.
fn send(under_way: &mut VecDeque<UnderWay>, said: Heard, at: LocalTime) {
    let place = under_way.partition_point(|earlier| earlier.heard.at <= at);
    under_way.insert(place, UnderWay { heard: Heard { at, ..said }, said_at: said.at });
}

#[cfg(test)]
mod tests;
