//! `skein order`: sends an order to a live swarm, from any PC. An order is a register that agents merge and pass on, so
//! it has to reach only one of them.

mod effect;
mod result;

use std::collections::BTreeMap;
use std::thread;
use std::time::{Duration, Instant};

use crate::keys::Role;
use skein_common::id::{TeamId, VehicleId};
use skein_common::message::{Order, Verb};
use skein_common::scenario::{Source, load};

use crate::observe::{Observer, TraceSubscription, VehicleView};
use crate::reach::{Reach, SwarmArgs};
pub(crate) use effect::ranges;
use effect::{Activity, Effect};
use result::Given;
use skein_host::clock;
use skein_lab::error::Error;
use skein_lab::terminal::{json, say};

/// How long to wait for heartbeats. An agent sends five a second; one that is silent for this long is not there.
const LISTEN: Duration = Duration::from_millis(1500);
/// Time within which an order spreads to every vehicle in contact.
const SPREAD: Duration = Duration::from_secs(5);
/// Time within which the heartbeats show what an accepted order has changed.
const SETTLED: Duration = Duration::from_secs(1);
/// Interval at which the order is published again.
const REPEAT: Duration = Duration::from_millis(200);

/// `skein order`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein order hold\n  skein order goto 0\n  skein order hold --teams 1,3\n  skein order land -f cluster.toml"
)]
pub struct OrderArgs {
    /// The order
    #[command(subcommand)]
    pub verb: VerbArg,
    /// The swarm to order.
    #[command(flatten)]
    pub swarm: SwarmArgs,
    /// The teams of a fleet to order, such as 1,3; without it all of them
    #[arg(long, global = true, value_name = "N,...", value_delimiter = ',')]
    pub teams: Vec<TeamId>,
    /// Print what was ordered, which vehicles accepted it and which did not answer, as one JSON object
    #[arg(long, global = true)]
    pub json: bool,
}

/// The orders of an operator.
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

/// Sends the order and prints what it has changed.
///
/// # Errors
/// If no vehicle answers, the mission has no such step, a vehicle in contact does not accept the order, or the order
/// changes nothing.
pub fn run(args: &OrderArgs) -> Result<(), Error> {
    let place = args.swarm.choose()?;
    let reaches = place.reach_teams(Role::Operator, &args.teams)?;
    let verb = args.verb.into();
    // Each team agrees on its own: no team waits for another.
    let results: Vec<Given> = thread::scope(|scope| {
        let given: Vec<_> = reaches.iter().map(|reach| (reach, scope.spawn(|| give(reach, verb)))).collect();
        let joined = given.into_iter().map(|(reach, given)| {
            let failed = |_| Given::failed(Error::Failed(format!("{verb}: the order to {} failed", reach.title())));
            given.join().unwrap_or_else(failed)
        });
        joined.collect()
    });
    if args.json {
        say(&json(&result::as_json(place.swarm(), verb, &reaches, &results)));
    }
    let has_one = reaches.len() == 1;
    let mut failures = Vec::new();
    for (reach, given) in reaches.iter().zip(results) {
        let team = reach.branch.team().filter(|_| !has_one).map_or_else(String::new, |team| format!("team {team}: "));
        match given.verdict(verb) {
            Err(error) if has_one => return Err(error),
            Err(error) => failures.push(format!("{team}{error}")),
            Ok(_) if args.json => {}
            Ok(text) => say(&format!("{team}{text}\n")),
        }
    }
    if failures.is_empty() { Ok(()) } else { Err(Error::Failed(failures.join("\n"))) }
}

/// Gives the order to one swarm.
fn give(reach: &Reach, verb: Verb) -> Given {
    let mut given = Given::default();
    if let Err(error) = send(reach, verb, &mut given) {
        given.error = Some(error);
    }
    given
}

fn send(reach: &Reach, verb: Verb, given: &mut Given) -> Result<(), Error> {
    let mut observer = Observer::open(reach, TraceSubscription::Off)?;
    wait_for_heartbeats(std::slice::from_mut(&mut observer), std::slice::from_ref(reach));
    let answer: Vec<VehicleId> = senders(&observer).collect();
    given.silent = reach.agents.keys().copied().filter(|id| !answer.contains(id)).collect();
    if answer.is_empty() {
        return Err(Error::Failed(format!("no vehicle of {} answered", reach.title())));
    }
    if let Verb::Goto(step) = verb
        && let Some(why) = missing_step_of(&observer, reach, step)
    {
        return Err(Error::Refused(why));
    }
    let before = effect::activities(&observer);
    if verb != Verb::Abort && before.values().any(|activity| *activity == Activity::Aborted) {
        return Err(Error::Failed(format!(
            "{verb}: refused, because {} was ordered to abort and no order can undo that",
            reach.title()
        )));
    }
    let order = new_order(&observer, verb);
    if observer.signed(order).is_empty() {
        return Err(Error::Failed(format!("no vehicle of {} reported the run that it flies in", reach.title())));
    }
    note_order(reach, verb);
    (given.accepted, given.unresponsive) = distribute(&mut observer, &order)?;
    given.silent.retain(|id| !given.accepted.contains(id) && !given.unresponsive.contains(id));
    given.effect = wait_for_effect(&mut observer, &before);
    Ok(())
}

/// Records an order on this PC before it is sent, so that a run that was ordered to land is not joined again.
pub fn note_order(reach: &Reach, verb: Verb) {
    let noted = reach.run_file.as_ref().map_or(Ok(()), |file| file.note_order(verb));
    if let Err(why) = noted {
        // The order is sent in any case: it must not wait for a disk.
        skein_lab::terminal::complain(&format!(
            "the order could not be recorded on this PC ({why}): make sure that all vehicles have landed before the next `up`"
        ));
    }
}

/// The error text if the mission in flight has no such step. `None` also if the vehicles fly another plan than is known
/// here: then only the effect of the order shows whether the step exists.
fn missing_step_of(observer: &Observer, reach: &Reach, step: u32) -> Option<String> {
    let (name, text) = reach.flown().ok()?;
    let scenario = load(&Source { name: &name, text: &text }, &[]).ok()?.scenario;
    let plan = scenario.plan_hash();
    let fly_it = observer.vehicles().values().filter_map(|view| view.mission).all(|mission| mission.plan == plan);
    effect::missing_step(&scenario, step).filter(|_| fly_it)
}

/// Waits until the order has changed what every vehicle does, or until [`SETTLED`] has passed.
fn wait_for_effect(observer: &mut Observer, before: &BTreeMap<VehicleId, Activity>) -> Effect {
    let until = clock::now() + SETTLED;
    loop {
        observer.poll();
        let effect = Effect::of(before, effect::activities(observer));
        if effect.is_all() || clock::now() >= until {
            return effect;
        }
        clock::sleep(Duration::from_millis(20));
    }
}

/// A new order that supersedes every order that a vehicle repeats. Its issuer is a random number, so that no two
/// issuers are the same.
pub fn new_order(observer: &Observer, verb: Verb) -> Order {
    Order { epoch: observer.next_epoch(), issuer: crate::os::random(), verb, signature: None }
}

/// Waits until every agent of these swarms has sent a heartbeat, or until `LISTEN` has passed.
pub fn wait_for_heartbeats(observers: &mut [Observer], reaches: &[Reach]) {
    let until = clock::now() + LISTEN;
    let agents = reaches.iter().map(|reach| reach.agents.len()).sum();
    while clock::now() < until && observers.iter().flat_map(senders).count() < agents {
        clock::sleep(Duration::from_millis(20));
        observers.iter_mut().for_each(|observer| drop(observer.poll()));
    }
}

/// The vehicles from which a heartbeat was received.
fn senders(observer: &Observer) -> impl Iterator<Item = VehicleId> {
    observer.vehicles().iter().filter(|(_, view)| view.mission.is_some()).map(|(id, _)| *id)
}

/// Publishes the order until every vehicle in contact has accepted it, or until `SPREAD` has passed. Returns the
/// vehicles that have accepted it and those in contact that have not.
///
/// # Errors
/// If Zenoh refuses.
pub fn distribute(observer: &mut Observer, order: &Order) -> Result<(Vec<VehicleId>, Vec<VehicleId>), Error> {
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
        let has_accepted = |view: &VehicleView| observer.order_of(view) >= Some(*order);
        let ids = |filter: fn(bool, bool) -> bool| {
            let vehicles = observer.vehicles().iter();
            vehicles.filter(|(_, view)| filter(has_accepted(view), view.alive)).map(|(id, _)| *id).collect::<Vec<_>>()
        };
        let (accepted, unresponsive) = (ids(|accepted, _| accepted), ids(|accepted, alive| alive && !accepted));
        if unresponsive.is_empty() || clock::now() >= until {
            return Ok((accepted, unresponsive));
        }
    }
}
