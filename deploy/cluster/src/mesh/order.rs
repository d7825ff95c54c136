//! `skein order`: sends an order to a live swarm, from any PC. An order is a register that agents merge and pass on, so
//! it has to reach only one of them. `skein order set` changes keys in flight in the same way.

mod effect;
mod recipients;
mod result;

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use skein_common::id::{TeamId, VehicleId, VehicleName, VehicleSet};
use skein_common::message::{Order, StandingOrders, Verb};
use skein_common::scenario::{Scenario, Setting, Source, load};
use skein_core::tuning;

use crate::mesh::observe::{Observer, VehicleView};
use crate::mesh::reach::{Place, Reach, SwarmArgs};
pub use effect::ranges;
use effect::{Activity, Effect};
use recipients::Recipients;
use result::Given;
use skein_host::clock;
use skein_host::parallel::at_once;
use skein_lab::error::Error;
use skein_lab::terminal::{json, say};

/// Time to wait for heartbeats. An agent sends five a second; one that is silent for this long is not there.
const LISTEN: Duration = Duration::from_millis(1500);
/// Time to wait for another one of the orders that an agent knows: two heartbeats may be lost.
const NEXT_ORDER: Duration = Duration::from_millis(600);
/// Time within which an order spreads to every vehicle in contact.
const SPREAD: Duration = Duration::from_secs(5);
/// Time within which the heartbeats show what an accepted order has changed.
const SETTLED: Duration = Duration::from_secs(1);
/// Interval at which the order is published again.
const REPEAT: Duration = Duration::from_millis(200);

/// `skein order`
#[derive(Clone, Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  skein order hold\n  skein order goto 0\n  skein order hold --teams 1,3\n  skein order release --vehicles 3\n  skein order land -f cluster.toml\n  skein order set formation.radius_m=80"
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
    /// The vehicles to order, such as 1,3 or 1-3; without it the whole swarm. The others fly on and do not wait for these
    #[arg(long, global = true, value_name = "IDS")]
    pub vehicles: Option<VehicleSet>,
    /// Print what was ordered, which vehicles accepted it and which did not answer, as one JSON object
    #[arg(long, global = true)]
    pub json: bool,
}

/// The orders of an operator.
#[derive(Clone, Debug, PartialEq, Eq, clap::Subcommand)]
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
    /// Give the controls of the vehicles that --vehicles names to human pilots, until a goto that names them takes them back
    Release,
    /// Change keys of the formation in flight, for the whole swarm. Each value moves to the new one at a bounded rate
    Set {
        /// Keys that can change in flight, each with its new value, such as formation.radius_m=80
        #[arg(value_name = "KEY=VALUE", required = true)]
        settings: Vec<Setting>,
    },
}

impl VerbArg {
    /// The orders to send, one after the other; of two settings of a key the last one.
    fn verbs(&self) -> Vec<Verb> {
        let settings = match self {
            Self::Hold => return vec![Verb::Hold],
            Self::Goto { step } => return vec![Verb::Goto(*step)],
            Self::Land => return vec![Verb::Land],
            Self::Abort => return vec![Verb::Abort],
            Self::Release => return vec![Verb::Release],
            Self::Set { settings } => settings,
        };
        let is_last = |nth: usize, setting: &Setting| settings[nth + 1..].iter().all(|later| later.key != setting.key);
        let last = settings.iter().enumerate().filter(|(nth, setting)| is_last(*nth, setting));
        last.map(|(_, setting)| Verb::Set(*setting)).collect()
    }
}

/// The orders as an operator writes them: `hold`, or `set formation.radius_m=80, formation.altitude_m=40`.
fn title(verbs: &[Verb]) -> String {
    let joined = |texts: &mut dyn Iterator<Item = String>| texts.collect::<Vec<_>>().join(", ");
    match settings(verbs).next() {
        Some(_) => format!("set {}", joined(&mut settings(verbs).map(|setting| setting.to_string()))),
        None => joined(&mut verbs.iter().map(Verb::to_string)),
    }
}

/// The settings among these orders.
fn settings(verbs: &[Verb]) -> impl Iterator<Item = Setting> {
    verbs.iter().filter_map(|verb| match verb {
        Verb::Set(setting) => Some(*setting),
        _ => None,
    })
}

/// Sends the order and prints what it has changed.
///
/// # Errors
/// If no vehicle answers, the mission has no such step, a vehicle in contact does not accept the order, or the order
/// changes nothing.
pub fn run(args: &OrderArgs) -> Result<(), Error> {
    let place = args.swarm.choose()?;
    let verbs = args.verb.verbs();
    let title = title(&verbs);
    let recipients = Recipients::of_teams(&place, &args.teams, args.vehicles)?;
    let results = give(&verbs, &recipients)?;
    if args.json {
        say(&json(&result::as_json(place.swarm(), &title, args.vehicles, &recipients, &results)));
    }
    let has_one = recipients.len() == 1;
    let mut failures = Vec::new();
    for (to, given) in recipients.iter().zip(results) {
        let team =
            to.reach.branch.team().filter(|_| !has_one).map_or_else(String::new, |team| format!("team {team}: "));
        match given.verdict(&title) {
            Err(error) if has_one => return Err(error),
            Err(error) => failures.push(format!("{team}{error}")),
            Ok(_) if args.json => {}
            Ok(text) => say(&format!("{team}{text}\n")),
        }
    }
    if failures.is_empty() { Ok(()) } else { Err(Error::Failed(failures.join("\n"))) }
}

/// The vehicles that a page orders.
pub enum Chosen {
    /// All vehicles of these teams; without a team all of the swarm or fleet.
    Teams(Vec<TeamId>),
    /// The vehicles with these names.
    Vehicles(Vec<VehicleName>),
}

/// Gives an order as [`run`] does, and returns what became of it in one line, and whether every vehicle has accepted it.
///
/// # Errors
/// If it cannot be sent to these vehicles.
pub fn give_to(place: &Place, verb: Verb, chosen: &Chosen) -> Result<(String, bool), Error> {
    let recipients = match chosen {
        Chosen::Teams(teams) => Recipients::of_teams(place, teams, None)?,
        Chosen::Vehicles(names) => Recipients::of_names(place, names)?,
    };
    let results = give(&[verb], &recipients)?;
    Ok(result::in_one_line(&title(&[verb]), &recipients, &results))
}

/// Gives the orders to all of them at the same time. Each team agrees on its own: no team waits for another.
fn give(verbs: &[Verb], recipients: &[Recipients]) -> Result<Vec<Given>, Error> {
    verbs.iter().try_for_each(|verb| Recipients::check(*verb, recipients))?;
    let give_to = |to: &Recipients| {
        let mut given = Given::default();
        given.error = send(to, verbs, &mut given).err();
        given
    };
    Ok(at_once(recipients.iter().map(|to| || give_to(to))))
}

fn send(to: &Recipients, verbs: &[Verb], given: &mut Given) -> Result<(), Error> {
    let (reach, vehicles) = (&to.reach, to.vehicles);
    let mut observer = Observer::open(reach)?;
    wait_for_heartbeats(std::slice::from_mut(&mut observer), std::slice::from_ref(reach));
    let answer: Vec<VehicleId> = senders(&observer).collect();
    given.silent = reach.agents.keys().copied().filter(|id| to.contain(*id) && !answer.contains(id)).collect();
    if answer.is_empty() {
        return Err(Error::Failed(format!("no vehicle of {} answered", reach.title())));
    }
    check_mission(&observer, reach, verbs)?;
    let before = effect::activities(&observer, vehicles);
    let is_final = |verb: &Verb| matches!(verb, Verb::Abort | Verb::Release);
    if !verbs.iter().all(is_final) && before.values().any(|activity| *activity == Activity::Aborted) {
        return Err(Error::Failed(format!(
            "{}: refused, because {} was ordered to abort and no order can undo that",
            title(verbs),
            reach.title()
        )));
    }
    // What is set together has the same epoch: one of two operators wins for all keys that both set.
    let new = new_order(&observer, Verb::Hold);
    let orders: Vec<Order> = verbs.iter().map(|verb| Order { verb: *verb, vehicles, ..new }).collect();
    if observer.signed(new).is_empty() {
        return Err(Error::Failed(format!("no vehicle of {} reported the run that it flies in", reach.title())));
    }
    if vehicles.is_none() {
        verbs.iter().for_each(|verb| note_order(reach, *verb));
    }
    (given.accepted, given.unresponsive) = distribute(&mut observer, &orders)?;
    let has_answered = |id: &VehicleId| given.accepted.contains(id) || given.unresponsive.contains(id);
    given.silent = reach.agents.keys().copied().filter(|id| to.contain(*id) && !has_answered(id)).collect();
    given.is_setting = matches!(verbs, [Verb::Set(_), ..]);
    if !given.is_setting {
        given.effect = wait_for_effect(&mut observer, vehicles, &before);
    }
    Ok(())
}

/// Checks what can be known before the orders are sent: that the mission has the step, and that the settings can be flown together
/// with those in force.
fn check_mission(observer: &Observer, reach: &Reach, verbs: &[Verb]) -> Result<(), Error> {
    let Some(scenario) = flown_scenario(observer, reach) else { return Ok(()) };
    let step = verbs.iter().find_map(|verb| match verb {
        Verb::Goto(step) => effect::missing_step(&scenario, *step),
        _ => None,
    });
    if let Some(why) = step {
        return Err(Error::Refused(why));
    }
    let new: Vec<Setting> = settings(verbs).collect();
    let in_force: StandingOrders = observer.vehicles().values().flat_map(|view| view.orders.iter()).collect();
    let mut all = in_force.settings_in_sequence();
    all.retain(|known| new.iter().all(|setting| setting.key != known.key));
    all.extend(&new);
    let found = scenario.settings_in_effect(&all, |tuned| tuning::check(&scenario, tuned));
    match found.refused.iter().find(|(setting, _)| new.contains(setting)) {
        Some((setting, why)) => Err(Error::Refused(format!("set {setting}: {why}"))),
        None => Ok(()),
    }
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

/// The scenario in flight. `None` if the vehicles fly another plan than is known here, or that cannot be read: then only the
/// effect of an order shows whether it can be flown.
fn flown_scenario(observer: &Observer, reach: &Reach) -> Option<Scenario> {
    let (name, text) = reach.flown().ok()?;
    let scenario = load(&Source { name: &name, text: &text }, &[]).ok()?.scenario;
    let plan = scenario.plan_hash();
    let mut missions = observer.vehicles().values().filter_map(|view| view.mission);
    missions.all(|mission| mission.plan == plan).then_some(scenario)
}

/// Waits until the order has changed what every vehicle does, or until [`SETTLED`] has passed.
fn wait_for_effect(
    observer: &mut Observer,
    vehicles: Option<VehicleSet>,
    before: &BTreeMap<VehicleId, Activity>,
) -> Effect {
    let until = clock::now() + SETTLED;
    loop {
        observer.poll();
        let effect = Effect::of(before, effect::activities(observer, vehicles));
        if effect.is_all() || clock::now() >= until {
            return effect;
        }
        clock::sleep(Duration::from_millis(20));
    }
}

/// A new order to the whole swarm that supersedes every order that a vehicle repeats. Its issuer is a random number, so that no two
/// issuers are the same.
pub fn new_order(observer: &Observer, verb: Verb) -> Order {
    Order { epoch: observer.next_epoch(), issuer: crate::os::random(), verb, vehicles: None, signature: None }
}

/// Waits until every agent of these swarms has sent a heartbeat, or until `LISTEN` has passed, and then until each agent that
/// sends heartbeats has repeated all orders that it knows: a new order has to be larger than they are.
pub fn wait_for_heartbeats(observers: &mut [Observer], reaches: &[Reach]) {
    let until = clock::now() + LISTEN;
    let agents = reaches.iter().map(|reach| reach.agents.len()).sum();
    while clock::now() < until && observers.iter().flat_map(senders).count() < agents {
        clock::sleep(Duration::from_millis(20));
        observers.iter_mut().for_each(|observer| drop(observer.poll()));
    }
    let known = |observers: &[Observer]| {
        let views = observers.iter().flat_map(|observer| observer.vehicles().values()).filter(|view| view.alive);
        views.filter_map(|view| Some((view.orders.len(), view.mission?.orders.into()))).collect::<Vec<(usize, usize)>>()
    };
    let (mut counts, mut until) = (known(observers), clock::now() + NEXT_ORDER);
    while counts.iter().any(|(received, sent)| received < sent) && clock::now() < until {
        clock::sleep(Duration::from_millis(20));
        observers.iter_mut().for_each(|observer| drop(observer.poll()));
        let before = std::mem::replace(&mut counts, known(observers));
        if counts != before {
            until = clock::now() + NEXT_ORDER;
        }
    }
}

/// The vehicles from which a heartbeat was received.
fn senders(observer: &Observer) -> impl Iterator<Item = VehicleId> {
    observer.vehicles().iter().filter(|(_, view)| view.mission.is_some()).map(|(id, _)| *id)
}

/// Publishes these orders to the same vehicles until every one of them in contact has accepted all, or until `SPREAD` has passed.
/// Returns the vehicles that have accepted them and those in contact that have not.
///
/// # Errors
/// If Zenoh refuses.
pub fn distribute(observer: &mut Observer, orders: &[Order]) -> Result<(Vec<VehicleId>, Vec<VehicleId>), Error> {
    let until = clock::now() + SPREAD;
    let mut next: Option<Instant> = None;
    loop {
        let now = clock::now();
        if next.is_none_or(|next| now >= next) {
            orders.iter().try_for_each(|order| observer.order(order))?;
            next = Some(now + REPEAT);
        }
        clock::sleep(Duration::from_millis(20));
        observer.poll();
        let has_accepted = |view: &VehicleView| orders.iter().all(|order| view.orders.contain(order));
        let are_to = |id: VehicleId| orders.iter().all(|order| order.is_to(id));
        let ids = |filter: fn(bool, bool) -> bool| {
            let vehicles = observer.vehicles().iter().filter(|(id, _)| are_to(**id));
            vehicles.filter(|(_, view)| filter(has_accepted(view), view.alive)).map(|(id, _)| *id).collect::<Vec<_>>()
        };
        let (accepted, unresponsive) = (ids(|accepted, _| accepted), ids(|accepted, alive| alive && !accepted));
        if unresponsive.is_empty() || clock::now() >= until {
            return Ok((accepted, unresponsive));
        }
    }
}
