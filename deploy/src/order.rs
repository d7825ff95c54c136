//! `skein order`: an order to a live swarm, from anywhere. It is a register that agents merge and pass on: it needs to
//! reach one of them.

mod effect;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use crate::keys::Role;
use skein_common::id::VehicleId;
use skein_common::message::{Order, Verb};
use skein_common::scenario::{Source, load};

use crate::observe::{Observer, Seen, Steps};
use crate::reach::{Reach, SwarmArgs};
pub(crate) use effect::ranges;
use effect::{Doing, Effect};
use skein_host::clock;
use skein_lab::error::Error;

/// An agent says its register five times a second; whoever is silent this long is not there.
const LISTEN: Duration = Duration::from_millis(1500);
/// Within this time an order has spread.
const SPREAD: Duration = Duration::from_secs(5);
/// A vehicle that has taken an order tells what it does now within this time, by several heartbeats.
const SETTLED: Duration = Duration::from_secs(1);
/// Between two sayings of the order.
const REPEAT: Duration = Duration::from_millis(200);

/// `skein order`
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein order hold\n  skein order goto 0\n  skein order land -f cluster.toml")]
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

/// Gives the order and tells what it has changed.
///
/// # Errors
/// If no swarm answers, the mission has no such step, not every vehicle in contact takes the order, or it changes nothing.
pub fn run(args: &OrderArgs) -> Result<(), Error> {
    let reach = args.swarm.reach(Role::Operator)?;
    let verb = args.verb.into();
    let mut observer = Observer::open(&reach, Steps::Unheard)?;
    listen(&mut observer, &reach);
    if speakers(&observer).next().is_none() {
        return Err(Error::Failed(format!("no vehicle of swarm {} answers", reach.swarm)));
    }
    if let Verb::Goto(step) = verb
        && let Some(why) = missing_step_of(&observer, &reach, step)
    {
        return Err(Error::Refused(why));
    }
    let before = effect::doing(&observer);
    if verb != Verb::Abort && before.values().any(|doing| *doing == Doing::Aborted) {
        return Err(Error::Failed(format!(
            "{verb}: swarm {} was ordered to abort, and no order takes that back",
            reach.swarm
        )));
    }
    let order = new(&observer, verb);
    if observer.sealed(order).is_empty() {
        return Err(Error::Failed(format!("no vehicle of swarm {} tells which run it flies in", reach.swarm)));
    }
    note(&reach, verb);
    let (taken, deaf) = give(&mut observer, &order)?;
    let effect = settle(&mut observer, &before);
    if !deaf.is_empty() {
        let deaf = ranges(&deaf);
        return Err(Error::Failed(format!("{verb}: not taken by vehicle {deaf}; of those in contact {effect}")));
    }
    if !effect.is_any() {
        return Err(Error::Failed(format!("{verb}: without effect: {effect}")));
    }
    skein_lab::terminal::say(&format!("{verb}: taken by vehicle {}; {effect}\n", ranges(&taken)));
    Ok(())
}

/// Notes an order before it is given, so that the run it is for is not joined again after a landing.
pub fn note(reach: &Reach, verb: Verb) {
    let noted = reach.run_file.as_ref().map_or(Ok(()), |file| file.note_order(verb));
    if let Err(why) = noted {
        // What is ordered may not wait for a disk.
        skein_lab::terminal::complain(&format!(
            "the order is not noted on this PC ({why}): see that all have landed before the next `up`"
        ));
    }
}

/// Why the mission that is flown has no such step. `None` also if the vehicles fly another plan than is known here: then what
/// the order changes is all that tells.
fn missing_step_of(observer: &Observer, reach: &Reach, step: u32) -> Option<String> {
    let (name, text) = reach.flown().ok()?;
    let scenario = load(&Source { name: &name, text: &text }, &[]).ok()?.scenario;
    let plan = scenario.plan_hash();
    let fly_it = observer.vehicles().values().filter_map(|seen| seen.mission).all(|mission| mission.plan == plan);
    effect::missing_step(&scenario, step).filter(|_| fly_it)
}

/// Waits until every vehicle does something else than before, or long enough for all of them to have told.
fn settle(observer: &mut Observer, before: &BTreeMap<VehicleId, Doing>) -> Effect {
    let until = clock::now() + SETTLED;
    loop {
        observer.poll();
        let effect = Effect::of(before, effect::doing(observer));
        if effect.is_all() || clock::now() >= until {
            return effect;
        }
        clock::sleep(Duration::from_millis(20));
    }
}

/// An order larger than all that were heard of, by an issuer whom nobody else is.
pub fn new(observer: &Observer, verb: Verb) -> Order {
    Order { epoch: observer.next_epoch(), issuer: crate::os::random(), verb, seal: None }
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
