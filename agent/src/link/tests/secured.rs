//! Secured links: who is invited takes part, and nobody else. The honest vehicles 1 and 2 go on talking through every attack;
//! what an intruder makes up is marked, and would be heard if it got through.

use std::collections::BTreeSet;
use std::fs;

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, date_time_ymd,
};
use skein_common::message::{Happening, PeerHealth};
use skein_common::state::Standing;
use tempfile::TempDir;
use zenoh::query::{ConsolidationMode, QueryTarget};

use super::security::{Names, Role, Tls};
use super::*;

/// The life and the issuer of everything that is made up.
const FORGED: Incarnation = Incarnation(u64::MAX);
const FORGER: u64 = 77;
/// Somebody who is not there.
const NOBODY: u8 = 7;
/// So often the honest vehicles hear each other during an attack.
const ROUNDS: u64 = 60;

/// Makes certificates.
struct Authority {
    folder: TempDir,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    fn new() -> Self {
        // What separates parts in some places, and does no harm in a path.
        let folder = tempfile::Builder::new().prefix("keys = , &").tempdir().unwrap();
        let key = KeyPair::generate().unwrap();
        let mut about = CertificateParams::default();
        about.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        about.distinguished_name.push(DnType::CommonName, "authority");
        let own = about.self_signed(&key).unwrap();
        fs::write(folder.path().join("authority.pem"), own.pem()).unwrap();
        Self { folder, issuer: Issuer::new(about, key) }
    }

    /// A certificate of this common name until the end of this year, and its key.
    fn certify(&self, name: &str, until_year: i32) {
        let key = KeyPair::generate().unwrap();
        let mut about = CertificateParams::new(["127.0.0.1".to_owned(), "::1".to_owned()]).unwrap();
        about.distinguished_name.push(DnType::CommonName, name);
        about.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        (about.not_before, about.not_after) = (date_time_ymd(2020, 1, 1), date_time_ymd(until_year, 12, 31));
        let certificate = about.signed_by(&key, &self.issuer).unwrap();
        fs::write(self.folder.path().join(format!("{name}.pem")), certificate.pem()).unwrap();
        fs::write(self.folder.path().join(format!("{name}.key")), key.serialize_pem()).unwrap();
    }

    fn tls(&self, name: &str, role: Role) -> Tls {
        self.certify(name, 2100);
        let file = |name: &str| self.folder.path().join(name);
        Tls {
            authority: file("authority.pem"),
            certificate: file(&format!("{name}.pem")),
            key: file(&format!("{name}.key")),
            role,
            names: names(),
        }
    }
}

/// Vehicle 3's first certificate was revoked.
fn names() -> Names {
    let mut names = Names::first(VehicleId::first(3));
    names.vehicles.insert(id(3), "vehicle-3.2".to_owned());
    names
}

/// Two honest vehicles, of which the second has dialled the first.
struct Swarm {
    name: SwarmName,
    authority: Authority,
    endpoints: Vec<String>,
    one: Link,
    two: Link,
    said: u64,
}

impl Swarm {
    fn begin(test: &str) -> Self {
        let here = ["tls/127.0.0.1:0".to_owned()];
        Self::with(test, |name, dial, tls| Sessions::open(name, &here, dial, &secured(tls)).unwrap())
    }

    /// The same, whose vehicles ask for certificates and have no rules.
    fn without_rules(test: &str) -> Self {
        Self::with(test, |name, dial, tls| unruly(name, &["tls/127.0.0.1:0".to_owned()], dial, tls).into())
    }

    fn with(test: &str, open: impl Fn(&SwarmName, &[String], Tls) -> Sessions) -> Self {
        let name = SwarmName::new(format!("{test}-{}", process::id())).unwrap();
        let authority = Authority::new();
        let mut endpoints = Vec::new();
        let [one, two] = [1, 2].map(|number| {
            let tls = authority.tls(&format!("vehicle-{number}"), Role::Vehicle(id(number)));
            let sessions = open(&name, &endpoints, tls);
            endpoints.extend(sessions.0[0].info().locators().wait().iter().map(ToString::to_string));
            let certificates = names().vehicles.into_iter().map(|(id, name)| (name, id)).collect();
            Link::new(sessions, id(number), LocalClock::start(), Trust { certificates, ..trust(&name) }).unwrap()
        });
        let mut swarm = Self { name, authority, endpoints, one, two, said: 0 };
        swarm.talk(1, || {});
        swarm
    }

    /// Somebody with this certificate who keeps to no rules.
    fn intruder(&self, tls: Tls) -> Session {
        unruly(&self.name, &[], &self.endpoints, tls)
    }

    /// Somebody with rules.
    fn guest(&self, name: &str, role: Role) -> Session {
        open(&self.name, &[], &self.endpoints, &secured(self.authority.tls(name, role))).unwrap()
    }

    /// So often each of the two says something new, `meanwhile` is done, and each hears the other. Gives all that they hear.
    fn talk(&mut self, rounds: u64, mut meanwhile: impl FnMut()) -> Vec<Heard> {
        let mut all = Vec::new();
        for _ in 0..rounds {
            let mut waits_for: BTreeSet<u8> = [1, 2].into();
            let deadline = now() + PATIENCE;
            while !waits_for.is_empty() {
                assert!(now() < deadline, "not heard: {waits_for:?}");
                self.said += 1;
                self.one.say_state(&state(1, self.said), Cell::default());
                self.two.say_state(&state(2, self.said), Cell::default());
                meanwhile();
                sleep_until(now() + Duration::from_millis(10));
                for (link, other) in [(&self.one, 2), (&self.two, 1)] {
                    let mut heard = Vec::new();
                    link.drain(&mut heard);
                    if word(&heard, |word| *word == Word::State(state(other, self.said))).is_some() {
                        waits_for.remove(&other);
                    }
                    all.append(&mut heard);
                }
            }
        }
        all
    }

    /// The two talk, and nothing of what is made up gets through to them.
    fn withstand(&mut self, mut attack: impl FnMut()) {
        let heard = self.talk(ROUNDS, &mut attack);
        assert_eq!(heard.iter().find(|heard| is_forged(&heard.word)), None);
        for vehicle in [1, 2] {
            let comes_or_goes =
                |word: &Word| matches!(word, Word::Appeared(who) | Word::Vanished(who) if who.get() == vehicle);
            // A link that breaks on a busy machine is back.
            let last = heard.iter().rev().find(|heard| comes_or_goes(&heard.word));
            assert!(!last.is_some_and(|last| matches!(last.word, Word::Vanished(_))), "{last:?}");
        }
        for link in [&self.one, &self.two] {
            assert_eq!(Drops { old: 0, ..link.drops() }, Drops::default(), "it was refused before it reached our code");
        }
    }
}

fn secured(tls: Tls) -> Security {
    Security::Tls(Box::new(tls))
}

fn unruly(swarm: &SwarmName, listen: &[String], dial: &[String], tls: Tls) -> Session {
    let mut all = configuration(swarm, listen, dial, &secured(tls)).unwrap();
    all.insert_json5("access_control", r#"{ "enabled": false }"#).unwrap();
    zenoh::open(all).wait().unwrap()
}

fn is_forged(word: &Word) -> bool {
    match word {
        Word::State(said) => said.header.incarnation == FORGED,
        Word::Mission(said) => said.header.incarnation == FORGED,
        Word::Order(order) => order.issuer == FORGER,
        Word::Appeared(who) | Word::Vanished(who) => who.get() == NOBODY,
    }
}

fn forged_header(sender: u8) -> Header {
    Header { incarnation: FORGED, ..state(sender, 1).header }
}

/// Says in everybody's name what can be said, and orders.
fn forge(session: &Session, senders: &[u8]) {
    for &sender in senders {
        let header = forged_header(sender);
        let cell = Cell::default();
        say(session, &Topic::State(id(sender), cell).key(), &encode(&State { header, ..state(sender, 1) }));
        say(session, &Topic::Mission(id(sender)).key(), &encode(&Mission { header, ..mission(sender, 1) }));
        say(session, &Topic::Event(id(sender)).key(), &encode(&Event { header, what: Happening::Landed }));
        say(session, &Topic::Health(id(sender)).key(), b"not even that");
    }
    let order = forged_order();
    say(session, &Topic::Order(FORGER).key(), &encode(&order));
}

fn forged_order() -> Order {
    Order { epoch: 9, issuer: FORGER, verb: Verb::Land, seal: None }
}

/// Tokens of those who have one and of one who has not; they come and go.
fn forge_tokens(session: &Session, senders: &[u8]) {
    for &sender in senders {
        drop(session.liveliness().declare_token(Topic::Alive(id(sender)).key()).wait().unwrap());
    }
    let nobody = session.liveliness().declare_token(Topic::Alive(id(NOBODY)).key());
    drop(nobody.wait().unwrap());
}

fn is_linked(session: &Session) -> bool {
    session.info().peers_zid().wait().next().is_some()
}

/// What the other tests rely on: without rules everything that is made up is heard.
#[test]
fn without_rules_a_valid_node_could_say_anything() {
    let swarm = Swarm::without_rules("unruly");
    let intruder = swarm.intruder(swarm.authority.tls("vehicle-3.2", Role::Vehicle(id(3))));
    wait_until(|| is_linked(&intruder));
    let mut heard = Vec::new();
    let deadline = now() + PATIENCE;
    let kinds: [fn(&Word) -> bool; 4] = [
        |word| matches!(word, Word::State(_)),
        |word| matches!(word, Word::Mission(_)),
        |word| matches!(word, Word::Order(_)),
        |word| matches!(word, Word::Appeared(_)),
    ];
    let is_heard =
        |heard: &[Heard]| kinds.iter().all(|kind| word(heard, |word| is_forged(word) && kind(word)).is_some());
    while !is_heard(&heard) {
        assert!(now() < deadline, "{heard:?}");
        forge(&intruder, &[1, 2]);
        let token = intruder.liveliness().declare_token(Topic::Alive(id(NOBODY)).key()).wait().unwrap();
        swarm.one.drain(&mut heard);
        pause();
        drop(token);
    }
}

#[test]
fn whoever_is_invited_takes_part_fully() {
    let mut swarm = Swarm::begin("honest");
    let observer = swarm.guest("observer", Role::Observer);
    let operator = swarm.guest("operator", Role::Operator);
    let subscriber =
        |key| observer.declare_subscriber(key).with(zenoh::handlers::FifoChannel::new(4096)).wait().unwrap();
    let (states, missions, events, traces) =
        (subscriber(all::STATES), subscriber(all::MISSIONS), subscriber(all::EVENTS), subscriber(all::TRACES));
    let healths = subscriber(all::HEALTH);
    let tokens = observer.liveliness().declare_subscriber(all::ALIVE).history(true).wait().unwrap();
    wait_until(|| swarm.one.trace_is_wanted() && swarm.two.trace_is_wanted());
    let mut lines = [&swarm.one, &swarm.two].map(|link| link.health(|| 0).unwrap());

    let mut there = BTreeSet::new();
    let mut told = [false; 4];
    let deadline = now() + PATIENCE;
    while there.len() < 2 || told != [true; 4] {
        assert!(now() < deadline, "tokens {there:?}, told {told:?}");
        swarm.talk(1, || {});
        swarm.one.say_mission(&mission(1, 1));
        swarm.two.say_event(&Event { header: state(2, 1).header, what: Happening::Landed });
        for publisher in lines.iter().flat_map(|line| &line.line.publishers) {
            publisher.put(b"health").wait().unwrap();
        }
        there.extend(tokens.drain().map(|token| token.key_expr().as_str().to_owned()));
        for (told, lines) in told.iter_mut().zip([&states, &missions, &events, &healths]) {
            *told |= lines.drain().count() > 0;
        }
    }
    assert_eq!(traces.drain().count(), 0, "nobody has said one");

    // Registers by query, as a late observer asks for them.
    let answers = observer.get("vehicle/*/mission").timeout(PATIENCE).wait().unwrap();
    let keys: Vec<String> = answers.iter().map(|reply| reply.result().unwrap().key_expr().to_string()).collect();
    assert_eq!(keys, ["vehicle/1/mission"]);

    // Clocks by query, both ways round.
    for (line, other) in lines.iter_mut().zip([2, 1]) {
        let mut peers = [PeerHealth { id: id(other), standing: Standing::Fresh, age_s: 0.0, clock: None }];
        line.live = vec![id(other)];
        let deadline = now() + PATIENCE;
        while peers[0].clock.is_none() {
            assert!(now() < deadline, "{other} does not tell its time");
            line.ask_a_clock();
            pause();
            line.clocks.tell(&mut peers);
        }
    }

    let order = Order { epoch: 1, issuer: 9, verb: Verb::Land, seal: None };
    for link in [&swarm.one, &swarm.two] {
        let give = || say(&operator, &Topic::Order(9).key(), &encode(&order));
        until(link, give, |heard| word(heard, |word| *word == Word::Order(order)));
    }
}

#[test]
fn a_late_vehicle_has_the_registers_of_the_others() {
    let swarm = Swarm::begin("late-secured");
    swarm.one.say_mission(&mission(1, 5));
    let late = link(swarm.guest("vehicle-3.2", Role::Vehicle(id(3))), 3, trust(&swarm.name));
    until(&late, || {}, |heard| word(heard, |word| *word == Word::Mission(mission(1, 5))));
    until(&swarm.two, || {}, |heard| word(heard, |word| *word == Word::Appeared(id(3))));
}

#[test]
fn who_has_no_certificate_is_not_let_in() {
    let mut swarm = Swarm::begin("none");
    let mut all = configuration(&swarm.name, &[], &swarm.endpoints, &Security::Plain).unwrap();
    let authority = swarm.authority.folder.path().join("authority.pem");
    all.insert_json5("transport/link/tls", &json!({ "root_ca_certificate": authority }).to_string()).unwrap();
    let intruder = zenoh::open(all).wait().unwrap();
    swarm.withstand(|| {
        forge(&intruder, &[1, 2]);
        forge_tokens(&intruder, &[1, 2]);
    });
    assert!(!is_linked(&intruder));
}

#[test]
fn a_certificate_of_another_authority_is_worth_nothing() {
    let mut swarm = Swarm::begin("other");
    let others = Authority::new();
    let tls = others.tls("vehicle-3.2", Role::Vehicle(id(3)));
    // It would take the swarm for its own, if the swarm took it.
    let intruder = swarm.intruder(Tls { authority: swarm.authority.folder.path().join("authority.pem"), ..tls });
    swarm.withstand(|| {
        forge(&intruder, &[1, 2, 3]);
        forge_tokens(&intruder, &[1, 2, 3]);
    });
    assert!(!is_linked(&intruder));
}

#[test]
fn an_expired_certificate_is_worth_nothing() {
    let mut swarm = Swarm::begin("expired");
    let tls = swarm.authority.tls("vehicle-3.2", Role::Vehicle(id(3)));
    swarm.authority.certify("vehicle-3.2", 2021);
    let intruder = swarm.intruder(tls);
    swarm.withstand(|| {
        forge(&intruder, &[1, 2, 3]);
        forge_tokens(&intruder, &[1, 2, 3]);
    });
    assert!(!is_linked(&intruder));
}

/// Its certificate makes a link, over which nothing passes in either direction.
#[test]
fn a_name_that_was_replaced_is_neither_heard_nor_told_anything() {
    let mut swarm = Swarm::begin("revoked");
    let revoked = swarm.authority.tls("vehicle-3", Role::Vehicle(id(3)));
    let [intruder, ears] = [revoked.clone(), revoked].map(|tls| swarm.intruder(tls));
    let words = ears.declare_subscriber("**").wait().unwrap();
    let tokens = ears.liveliness().declare_subscriber("**").history(true).wait().unwrap();
    wait_until(|| is_linked(&intruder) && is_linked(&ears));
    swarm.one.say_mission(&mission(1, 1));
    swarm.withstand(|| {
        forge(&intruder, &[1, 2, 3]);
        forge_tokens(&intruder, &[1, 2, 3]);
    });
    assert_eq!((words.drain().count(), tokens.drain().count()), (0, 0));
    assert_eq!(ears.get("**").timeout(PATIENCE).wait().unwrap().iter().count(), 0);
    assert!(is_linked(&intruder) && is_linked(&ears));
}

/// What vehicle 3 says in its own name arrives, so that what it has said before in another's has been refused.
#[test]
fn a_valid_vehicle_speaks_for_itself_alone() {
    let mut swarm = Swarm::begin("branch");
    let intruder = swarm.intruder(swarm.authority.tls("vehicle-3.2", Role::Vehicle(id(3))));
    wait_until(|| is_linked(&intruder));
    let mut said = 0;
    let own = Topic::State(id(3), Cell::default()).key();
    for receiver in [1, 2] {
        for _ in 0..5 {
            forge(&intruder, &[1, 2]);
            forge_tokens(&intruder, &[1, 2]);
            said += 1;
            let link = if receiver == 1 { &swarm.one } else { &swarm.two };
            let heard = until(
                link,
                || say(&intruder, &own, &encode(&state(3, said))),
                |heard| word(heard, |word| *word == Word::State(state(3, said))).map(|_| heard.to_vec()),
            );
            assert_eq!(heard.iter().find(|heard| is_forged(&heard.word)), None);
        }
    }
    swarm.withstand(|| {
        forge(&intruder, &[1, 2]);
        forge_tokens(&intruder, &[1, 2]);
    });
}

/// The question reaches it, for it has a register of its own. The observer listens here, or the two would have no link.
#[test]
fn a_valid_vehicle_answers_for_itself_alone() {
    let swarm = Swarm::begin("reply");
    swarm.one.say_mission(&mission(1, 5));
    let tls = swarm.authority.tls("observer", Role::Observer);
    let observer = open(&swarm.name, &["tls/127.0.0.1:0".to_owned()], &swarm.endpoints, &secured(tls)).unwrap();
    let observed: Vec<String> = observer.info().locators().wait().iter().map(ToString::to_string).collect();
    let tls = swarm.authority.tls("vehicle-3.2", Role::Vehicle(id(3)));
    let intruder = unruly(&swarm.name, &[], &observed, tls);
    let answer = |query: zenoh::query::Query| {
        for sender in [1, 2, 3] {
            let said = Mission { header: forged_header(sender), ..mission(sender, 1) };
            query.reply(Topic::Mission(id(sender)).key(), encode(&said)).wait().unwrap();
        }
    };
    let _everybody = intruder.declare_queryable("vehicle/**").callback(answer).wait().unwrap();
    let _own = intruder.declare_queryable("vehicle/3/mission").callback(answer).wait().unwrap();
    let deadline = now() + PATIENCE;
    loop {
        let asked = observer.get("vehicle/*/mission").target(QueryTarget::All).consolidation(ConsolidationMode::None);
        let answers = asked.timeout(PATIENCE).wait().unwrap();
        let said = |reply: zenoh::query::Reply| {
            let sample = reply.into_result().unwrap();
            let said: Mission = message::decode(&sample.payload().to_bytes()).unwrap();
            (sample.key_expr().to_string(), said.header.sender.get(), said.header.incarnation == FORGED)
        };
        let all: BTreeSet<_> = answers.iter().map(said).collect();
        let honest = ("vehicle/1/mission".to_owned(), 1, false);
        let own = ("vehicle/3/mission".to_owned(), 3, true);
        if all == [honest, own.clone()].into() {
            break;
        }
        assert!(now() < deadline && all.iter().all(|said| !said.2 || *said == own), "{all:?}");
        pause();
    }
}

#[test]
fn an_observer_says_nothing() {
    let mut swarm = Swarm::begin("observer-says");
    let intruder = swarm.intruder(swarm.authority.tls("observer", Role::Observer));
    wait_until(|| is_linked(&intruder));
    swarm.one.say_mission(&mission(1, 1));
    swarm.withstand(|| {
        forge(&intruder, &[1, 2, 3]);
        forge_tokens(&intruder, &[1, 2, 3]);
    });
    // It is linked and asks: what it has said before on the same way was refused.
    let answers = intruder.get("vehicle/1/mission").timeout(PATIENCE).wait().unwrap();
    assert_eq!(answers.iter().count(), 1);
    swarm.withstand(|| {});
}

/// An operator is no vehicle.
#[test]
fn the_operator_only_orders() {
    let mut swarm = Swarm::begin("operator-says");
    let operator = swarm.intruder(swarm.authority.tls("operator", Role::Operator));
    let order = Order { epoch: 1, issuer: 9, verb: Verb::Hold, seal: None };
    let is_order = |word: &Word| matches!(word, Word::Order(_));
    for link in [&swarm.one, &swarm.two] {
        until(link, || say(&operator, &Topic::Order(9).key(), &encode(&order)), |heard| word(heard, is_order));
    }
    let heard = swarm.talk(ROUNDS, || {
        forge(&operator, &[1, 2, 3]);
        forge_tokens(&operator, &[1, 2, 3]);
    });
    assert_eq!(word(&heard, |word| is_forged(word) && !is_order(word)), None);
    assert!(word(&heard, is_order).is_some(), "the link is there");
}

/// Zenoh knows a session by a number that everybody is shown who is linked to it.
#[test]
fn nobody_takes_anothers_place_by_its_number() {
    let mut swarm = Swarm::begin("number");
    let all = [&swarm.one, &swarm.two].map(|link| link.sessions.0.iter().map(|session| session.zid().to_string()));
    let [ones, twos] = all.map(Iterator::collect::<Vec<_>>);
    let revoked = swarm.authority.tls("vehicle-3", Role::Vehicle(id(3)));
    let intruders: Vec<_> = [(&ones, 1), (&twos, 0)]
        .into_iter()
        .flat_map(|(numbers, victim)| numbers.iter().map(move |number| (number, victim)))
        .map(|(number, victim)| as_number(&swarm, number, &[], &swarm.endpoints[victim..=victim], revoked.clone()))
        .collect();
    assert_eq!(intruders.len(), 3, "vehicle 1 dials nobody");
    swarm.withstand(|| {
        for intruder in &intruders {
            forge(intruder, &[1, 2]);
            forge_tokens(intruder, &[1, 2]);
        }
    });
}

/// A node that is dialled can still take the number of another that is: what is said over that session is not believed.
#[test]
fn nobody_speaks_for_another_by_its_number() {
    let swarm = Swarm::begin("voice");
    let free = std::net::TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let of_intruder = vec![format!("tls/{free}")];
    let dial = [&swarm.endpoints[..1], &of_intruder].concat();
    let tls = swarm.authority.tls("vehicle-3.2", Role::Vehicle(id(3)));
    let sessions = Sessions::open(&swarm.name, &["tls/127.0.0.1:0".to_owned()], &dial, &secured(tls)).unwrap();
    let certificates = names().vehicles.into_iter().map(|(id, name)| (name, id)).collect();
    let trust = Trust { certificates, ..trust(&swarm.name) };
    let three = Link::new(sessions, id(3), LocalClock::start(), trust).unwrap();
    until(&three, || {}, |heard| word(heard, |word| *word == Word::Appeared(id(1))));

    let number = swarm.one.sessions.0[0].zid().to_string();
    let intruder =
        as_number(&swarm, &number, &of_intruder, &[], swarm.authority.tls("vehicle-2", Role::Vehicle(id(2))));
    let mut heard = Vec::new();
    let deadline = now() + PATIENCE;
    while three.drops().forged < 20 {
        assert!(now() < deadline, "{:?}", three.drops());
        forge(&intruder, &[1]);
        three.drain(&mut heard);
        pause();
    }
    assert_eq!(word(&heard, is_forged), None);
}

/// Somebody who keeps to no rules and has chosen the number of its session.
fn as_number(swarm: &Swarm, number: &str, listen: &[String], dial: &[String], tls: Tls) -> Session {
    let mut all = configuration(&swarm.name, listen, dial, &secured(tls)).unwrap();
    all.insert_json5("access_control", r#"{ "enabled": false }"#).unwrap();
    all.insert_json5("id", &json!(number).to_string()).unwrap();
    zenoh::open(all).wait().unwrap()
}

/// Peers hand nothing on, but a router would, if they listened to it.
#[test]
fn a_router_is_nobody_special() {
    let mut swarm = Swarm::begin("router");
    let mut all = {
        let tls = secured(swarm.authority.tls("vehicle-3", Role::Vehicle(id(3))));
        configuration(&swarm.name, &[], &swarm.endpoints, &tls).unwrap()
    };
    all.insert_json5("access_control", r#"{ "enabled": false }"#).unwrap();
    all.insert_json5("mode", r#""router""#).unwrap();
    let intruder = zenoh::open(all).wait().unwrap();
    swarm.withstand(|| {
        forge(&intruder, &[1, 2, 3]);
        forge_tokens(&intruder, &[1, 2, 3]);
    });
}

#[test]
fn keys_that_are_none_are_named() {
    let authority = Authority::new();
    let name = SwarmName::new("named").unwrap();
    let good = authority.tls("vehicle-1", Role::Vehicle(id(1)));
    let refused =
        |tls: Tls, listen: &str| open(&name, &[listen.to_owned()], &[], &secured(tls)).unwrap_err().to_string();
    let here = "tls/127.0.0.1:0";
    let missing = authority.folder.path().join("missing.pem");
    let named = missing.display().to_string();
    let error = refused(Tls { certificate: missing, ..good.clone() }, here);
    assert!(error.starts_with(&named) && error.contains("No such file"), "{error}");
    let error = refused(Tls { key: good.certificate.clone(), ..good.clone() }, here);
    assert!(error.ends_with("vehicle-1.pem: no PRIVATE KEY in it"), "{error}");
    let error = refused(good.clone(), "tcp/127.0.0.1:0");
    assert_eq!(error, "\"tcp/127.0.0.1:0\": links are secured here, so an endpoint is written like tls/10.0.0.11:7447");
    let error = open(&name, &[], &[here.to_owned()], &Security::Plain).unwrap_err();
    assert!(error.is_the_users() && error.to_string().contains("no keys for secured links"), "{error}");
    let error = refused(Tls { role: Role::Vehicle(id(4)), ..good.clone() }, here);
    assert_eq!(error, "the names of certificates do not tell vehicle 4's");
    let names = Names { observer: "vehicle-2".to_owned(), ..good.names.clone() };
    assert!(refused(Tls { names, ..good }, here).contains("\"vehicle-2\""));
}

#[test]
fn links_over_ipv6_are_secured_too() {
    let authority = Authority::new();
    let name = SwarmName::new(format!("six-{}", process::id())).unwrap();
    let tls = |number| secured(authority.tls(&format!("vehicle-{number}"), Role::Vehicle(id(number))));
    if std::net::TcpListener::bind("[::1]:0").is_err() {
        // A machine without IPv6.
        return;
    }
    let one = open(&name, &["tls/[::1]:0".to_owned()], &[], &tls(1)).unwrap();
    let dial: Vec<String> = one.info().locators().wait().iter().map(ToString::to_string).collect();
    let two = open(&name, &[], &dial, &tls(2)).unwrap();
    wait_until(|| is_linked(&two));
}
