//! What the network does to what one agent hears: words that are lost, words that are late, links that are cut.
//!
//! All of it happens at the hearing end, so that the same [`Ear`] makes a study's network and, between Zenoh and the agent,
//! a real one's faults. Chance comes from the scenario's seed.
//!
//! * A state, a part in the agreement or an order is lost with the probability `network.loss`, each on its own. Tokens are
//!   never lost: Zenoh repeats them.
//! * Everything takes `network.delay_s` longer.
//! * A cut silences directions of links, and ends sessions as `link.rs` tells.

mod cuts;
mod link;

use std::collections::VecDeque;

use rand_chacha::ChaCha8Rng;
use skein_common::id::VehicleId;
use skein_common::scenario::Scenario;
use skein_common::time::LocalTime;

use crate::peers::{Heard, Word};
use crate::random::{self, Purpose};
pub use cuts::{lasting, silences, union};
use link::Link;

/// The network as one agent hears it.
#[derive(Clone, Debug)]
pub struct Ear {
    loss: f64,
    delay_s: f64,
    generator: ChaCha8Rng,
    /// Those that are ever cut, by the other end's id.
    links: Vec<Link>,
    /// What has yet to arrive, the earliest first.
    under_way: VecDeque<Heard>,
}

impl Ear {
    /// The hearing of vehicle `own` at the beginning of a life.
    pub fn new(scenario: &Scenario, own: VehicleId) -> Self {
        let peers = scenario.ids().filter(|&id| id != own);
        Self {
            loss: scenario.network.loss,
            delay_s: scenario.network.delay_s,
            generator: random::generator(scenario.seed, Some(own), Purpose::Network),
            links: peers.filter_map(|peer| Link::new(scenario, own, peer)).collect(),
            under_way: VecDeque::new(),
        }
    }

    /// Moves to the end of `out` what is heard by `now`, in the order in which it arrives. `arriving` is what a perfect
    /// network brings, each with the time at which it does; `flown_s` counts from the own take-off, as the cuts do: `None`
    /// before it.
    pub fn hear(
        &mut self,
        now: LocalTime,
        flown_s: Option<f64>,
        arriving: impl IntoIterator<Item = Heard>,
        out: &mut Vec<Heard>,
    ) {
        if self.loss == 0.0 && self.delay_s == 0.0 && self.links.is_empty() {
            out.extend(arriving);
            return;
        }
        let Self { links, under_way, delay_s, .. } = self;
        if let Some(flown_s) = flown_s {
            for link in links {
                link.update(flown_s, |word| send(under_way, *delay_s, Heard { word, at: now }));
            }
        }
        for heard in arriving {
            if !self.loses(&heard.word) && self.gets_through(&heard.word) {
                send(&mut self.under_way, self.delay_s, heard);
            }
        }
        let arrived = self.under_way.partition_point(|heard| heard.at <= now);
        out.extend(self.under_way.drain(..arrived));
    }

    fn loses(&mut self, word: &Word) -> bool {
        let may_be_lost = match word {
            Word::State(_) | Word::Mission(_) | Word::Order(_) => self.loss > 0.0,
            Word::Appeared(_) | Word::Vanished(_) => false,
        };
        may_be_lost && random::uniform(&mut self.generator) < self.loss
    }

    /// An operator is at no end of a link that a cut names.
    fn gets_through(&mut self, word: &Word) -> bool {
        let speaker = match word {
            Word::State(said) => said.header.sender,
            Word::Mission(said) => said.header.sender,
            Word::Appeared(id) | Word::Vanished(id) => *id,
            Word::Order(_) => return true,
        };
        match self.links.binary_search_by_key(&speaker, Link::peer) {
            Ok(index) => self.links[index].carries(word),
            Err(_) => true,
        }
    }
}

/// Puts a word where its arrival belongs: behind those that arrive no later.
fn send(under_way: &mut VecDeque<Heard>, delay_s: f64, heard: Heard) {
    let at = heard.at.plus_seconds(delay_s);
    let place = under_way.partition_point(|earlier| earlier.at <= at);
    under_way.insert(place, Heard { at, ..heard });
}

#[cfg(test)]
mod tests;
