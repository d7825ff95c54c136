//! `skein order`: an order to a live swarm, from anywhere. It is a register that agents merge and pass on: it needs to
//! reach one of them.

use std::hash::{BuildHasher, RandomState};
use std::time::{Duration, Instant};

use crate::reach::Role;
use skein_common::id::VehicleId;
use skein_common::message::{Order, Verb};

use crate::clock;
use crate::error::Error;
use crate::observe::{Observer, Seen, Steps};
use crate::reach::{Reach, SwarmArgs};

/// An agent says its register five times a second; whoever is silent this long is not there.
const LISTEN: Duration = Duration::from_millis(1500);
/// Within this time an order has spread.
const SPREAD: Duration = Duration::from_secs(5);
/// Between two sayings of the order.
const REPEAT: Duration = Duration::from_millis(200);

/// `skein order`
#[derive(Clone, Debug, clap::Args)]
pub struct OrderArgs {
    /// What the swarm is to do
    #[command(subcommand)]
    pub verb: VerbArg,
    /// Whom to order.
    #[command(flatten)]
    pub swarm: SwarmArgs,
}

/// What an operator can ask for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::Subcommand)]
pub enum VerbArg {
    /// Stop where they are, at the altitude they have
    Hold,
    /// Fly on, at this step of the mission or a later one; ends a hold
    Goto {
        /// The step, counted from 0
        #[arg(value_name = "K")]
        step: u32,
    },
    /// Descend where they are, and end; until they are down, another order calls them back
    Land,
    /// Give up: descend where they are, and end, whatever is ordered later
    Abort,
}

impl From<VerbArg> for Verb {
    fn from(verb: VerbArg) -> Self {
        match verb {
            VerbArg::Hold => Self::Hold,
            VerbArg::Goto { step } => Self::Goto(step),
            VerbArg::Land => Self::Land,
            VerbArg::Abort => Self::Abort,
        }
    }
}

/// Gives the order and says who took it.
///
/// # Errors
/// If no swarm is there, or not every vehicle that is heard takes the order.
pub fn run(args: &OrderArgs) -> Result<(), Error> {
    let reach = args.swarm.reach(Role::Operator)?;
    let mut observer = Observer::open(&reach, Steps::Unheard)?;
    listen(&mut observer, &reach);
    if speakers(&observer).next().is_none() {
        return Err(Error::Failed(format!("nobody of the swarm {} answers", reach.swarm)));
    }
    let order = new(&observer, args.verb.into());
    let (taken, deaf) = give(&mut observer, &order)?;
    if !deaf.is_empty() {
        return Err(Error::Failed(format!("{}: not taken by vehicle {}", order.verb, list(&deaf))));
    }
    crate::say(&format!("{}: taken by vehicle {}\n", order.verb, list(&taken)));
    Ok(())
}

/// An order larger than all that were heard of, by an issuer whom nobody else is.
pub fn new(observer: &Observer, verb: Verb) -> Order {
    // The standard library's only source of randomness is the seed of its hashes.
    let issuer = RandomState::new().hash_one(std::process::id());
    observer.sealed(Order { epoch: observer.next_epoch(), issuer, verb, seal: None })
}

/// Waits until every agent has said its register, or long enough.
pub fn listen(observer: &mut Observer, reach: &Reach) {
    let until = clock::now() + LISTEN;
    while clock::now() < until && speakers(observer).count() < reach.agents.len() {
        clock::sleep(Duration::from_millis(20));
        observer.poll();
    }
}

/// Vehicles whose register was heard.
fn speakers(observer: &Observer) -> impl Iterator<Item = VehicleId> {
    observer.vehicles().iter().filter(|(_, seen)| seen.mission.is_some()).map(|(id, _)| *id)
}

/// Says the order until everybody who is there has taken it, or long enough. Gives who has, and who has not.
///
/// # Errors
/// If Zenoh refuses.
pub fn give(observer: &mut Observer, order: &Order) -> Result<(Vec<VehicleId>, Vec<VehicleId>), Error> {
    let until = clock::now() + SPREAD;
    let mut next: Option<Instant> = None;
    loop {
        let now = clock::now();
        if next.is_none_or(|next| now >= next) {
            observer.order(order)?;
            next = Some(now + REPEAT);
        }
        clock::sleep(Duration::from_millis(20));
        observer.poll();
        let has_taken = |seen: &Seen| observer.order_of(seen) >= Some(*order);
        let ids = |wanted: fn(bool, bool) -> bool| {
            let vehicles = observer.vehicles().iter();
            vehicles.filter(|(_, seen)| wanted(has_taken(seen), seen.alive)).map(|(id, _)| *id).collect::<Vec<_>>()
        };
        let (taken, deaf) = (ids(|taken, _| taken), ids(|taken, alive| alive && !taken));
        if deaf.is_empty() || clock::now() >= until {
            return Ok((taken, deaf));
        }
    }
}

fn list(ids: &[VehicleId]) -> String {
    ids.iter().map(VehicleId::to_string).collect::<Vec<_>>().join(", ")
}
