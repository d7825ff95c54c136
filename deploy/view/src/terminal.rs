//! `skein view --terminal`: the table of `skein fly`, of a swarm that another process has started.

use std::time::Duration;

use skein_common::id::{VehicleId, VehicleSet};
use skein_common::message::EventKind;
use skein_host::clock;
use skein_lab::error::Error;

use super::snapshot::Team;
use skein_cluster::display::journal::{self, Journal, When};
use skein_cluster::display::screen::Screen;
use skein_cluster::display::status::{self, FlightStatus, Known};
use skein_cluster::keys::Role;
use skein_cluster::mesh::observe::{Observer, Observers, SwarmMessage};
use skein_cluster::mesh::reach::SwarmArgs;
use skein_cluster::os::Interrupts;

/// Time between two looks at what has arrived.
const TICK: Duration = Duration::from_millis(50);
/// The screen has room for no more events.
const MOST_EVENTS: usize = 200;

/// Shows the table until Ctrl-C or q; the swarm flies on.
///
/// # Errors
/// If the swarm is not found.
pub(super) fn show(swarm: &SwarmArgs) -> Result<(), Error> {
    let place = swarm.choose()?;
    let described = place.described()?;
    let teams: Vec<Team> = described.all().iter().map(|loaded| Team::new(&loaded.scenario)).collect();
    let mut observers = Observers::open(&place.reach_teams(Role::Observer, &[])?)?;
    for observer in observers.each() {
        observer.subscribe_to_summaries(true)?;
    }
    let interrupts = Interrupts::listen()?;
    let (began, mut screen) = (clock::now(), Screen::open(false));
    let mut journals = vec![Journal::default(); teams.len()];
    while interrupts.count() == 0 && screen.asked_to_end() == 0 {
        let now = clock::now();
        for ((observer, journal), team) in observers.each().iter_mut().zip(&mut journals).zip(&teams) {
            for (received, at) in observer.poll_timed() {
                let SwarmMessage::Event(event) = received else { continue };
                let mut awaited: VehicleSet = team.scenario.ids().collect();
                if let EventKind::PeerFound(peer) | EventKind::PeerLost(peer) = event.what {
                    awaited.remove(peer);
                }
                let when = When { now: at, window_s: Some(at.saturating_duration_since(began).as_secs_f64()) };
                journal.add_alike(when, event.header.sender, journal::alike(&event.what), awaited);
            }
        }
        let has_news = journals.iter().any(|journal| journal.has_news(now));
        if screen.is_due(now, has_news) {
            let news: Vec<String> = journals.iter_mut().flat_map(|journal| journal.take_news(now, false)).collect();
            let parts = teams.iter().zip(observers.all()).zip(&journals);
            let mut statuses: Vec<FlightStatus> =
                parts.map(|((team, observer), journal)| flight_status(team, observer, journal, now)).collect();
            let status = match statuses.len() {
                1 => statuses.remove(0),
                _ => status::of_fleet(statuses, String::new()),
            };
            screen.show(&status, &news, now);
        }
        clock::sleep(TICK);
    }
    Ok(())
}

/// One team as people look at it.
fn flight_status(team: &Team, observer: &Observer, journal: &Journal, now: std::time::Instant) -> FlightStatus {
    let known = |id: VehicleId| Known::new(id, observer.vehicles().get(&id), None, now);
    let known: Vec<Known> = team.scenario.ids().map(known).collect();
    let flown = known.iter().filter_map(|known| known.flying()?.flown_s);
    FlightStatus {
        flown_s: flown.fold(0.0, f64::max),
        events: journal.newest(MOST_EVENTS),
        ..FlightStatus::new(&team.scenario, &known)
    }
}
