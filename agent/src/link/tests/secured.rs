//! Secured links: who is invited takes part, and speaks for itself alone. The honest vehicles 1 and 2 go on talking through
//! every attack; what an intruder makes up is marked, and would be heard if it got through.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::AtomicUsize;

use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, PKCS_ED25519,
    date_time_ymd,
};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use skein_common::message::{Happening, PeerHealth};
use skein_common::state::Standing;
use tempfile::TempDir;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::version::TLS13;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, Stream};

use super::security::{Known, Tls};
use super::tunnel::Tunnel;
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

    /// A certificate of this common name until the end of this year, of the key that it has.
    fn certify(&self, name: &str, until_year: i32) {
        let key = KeyPair::from_pem(&fs::read_to_string(self.key_file(name)).unwrap()).unwrap();
        let mut about = CertificateParams::new(["127.0.0.1".to_owned(), "::1".to_owned()]).unwrap();
        about.distinguished_name.push(DnType::CommonName, name);
        about.extended_key_usages = vec![ExtendedKeyUsagePurpose::ServerAuth, ExtendedKeyUsagePurpose::ClientAuth];
        (about.not_before, about.not_after) = (date_time_ymd(2020, 1, 1), date_time_ymd(until_year, 12, 31));
        let certificate = about.signed_by(&key, &self.issuer).unwrap();
        fs::write(self.folder.path().join(format!("{name}.pem")), certificate.pem()).unwrap();
    }

    fn key_file(&self, name: &str) -> PathBuf {
        let file = self.folder.path().join(format!("{name}.key"));
        if !file.exists() {
            fs::write(&file, KeyPair::generate_for(&PKCS_ED25519).unwrap().serialize_pem()).unwrap();
        }
        file
    }

    fn sealer(&self, name: &str) -> Arc<Sealer> {
        Arc::new(Sealer::from_pem(&fs::read_to_string(self.key_file(name)).unwrap()).unwrap())
    }

    fn tls(&self, name: &str) -> Tls {
        self.certify(name, 2100);
        let file = |name: &str| self.folder.path().join(name);
        Tls {
            authority: file("authority.pem"),
            certificate: file(&format!("{name}.pem")),
            key: self.key_file(name),
            vehicles: self.vehicles(),
            observer: "observer".to_owned(),
            operator: "operator".to_owned(),
        }
    }

    /// Vehicle 3's first certificate was revoked.
    fn vehicles(&self) -> BTreeMap<VehicleId, Known> {
        let known = |name: &str| Known { name: name.to_owned(), key: self.sealer(name).key() };
        let names = ["vehicle-1", "vehicle-2", "vehicle-3.2"];
        names.iter().zip(1..).map(|(name, number)| (id(number), known(name))).collect()
    }

    /// As an agent of this certificate is told.
    fn trust(&self, swarm: &SwarmName, name: &str) -> Trust {
        let security = secured(self.tls(name));
        Trust {
            voices: security.voices(swarm),
            sealer: Some(self.sealer(name)),
            orders: Some(self.sealer("operator").key()),
            ..trust(swarm)
        }
    }
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
        Self::with(test, |authority, swarm, vehicle| authority.trust(swarm, vehicle))
    }

    /// The same, whose vehicles ask for certificates and not for seals.
    fn without_seals(test: &str) -> Self {
        Self::with(test, |_, swarm, _| trust(swarm))
    }

    fn with(test: &str, trust: impl Fn(&Authority, &SwarmName, &str) -> Trust) -> Self {
        let name = SwarmName::new(format!("{test}-{}", process::id())).unwrap();
        let authority = Authority::new();
        let mut endpoints = Vec::new();
        let here = ["tls/127.0.0.1:0".to_owned()];
        let [one, two] = [1, 2].map(|number| {
            let vehicle = format!("vehicle-{number}");
            let sessions = Sessions::open(&name, &here, &endpoints, &secured(authority.tls(&vehicle))).unwrap();
            endpoints.extend(sessions.endpoints());
            let trust = trust(&authority, &name, &vehicle);
            Link::new(sessions, id(number), LocalClock::start(), trust).unwrap()
        });
        let mut swarm = Self { name, authority, endpoints, one, two, said: 0 };
        swarm.talk(1, || {});
        swarm
    }

    /// Somebody with this certificate.
    fn guest(&self, tls: Tls) -> Sessions {
        Sessions::open(&self.name, &[], &self.endpoints, &secured(tls)).unwrap()
    }

    /// What somebody makes up and seals with this key.
    fn forger(&self, name: &str) -> Forger {
        let security = secured(self.authority.tls(name));
        Forger { voices: security.voices(&self.name), sealer: self.authority.sealer(name) }
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
    }

    /// The same; and what was made up never reached our code.
    fn never_hear(&mut self, attack: impl FnMut()) {
        self.withstand(attack);
        for link in [&self.one, &self.two] {
            assert_eq!(
                Drops { old: 0, links: 0, ..link.drops() },
                Drops::default(),
                "it was refused before it reached our code"
            );
        }
    }

    /// The same; and what was made up is counted by both.
    fn refuse(&mut self, mut attack: impl FnMut()) {
        let deadline = now() + PATIENCE;
        while [&self.one, &self.two].iter().any(|link| link.drops().forged < 20) {
            assert!(now() < deadline, "{:?}, {:?}", self.one.drops(), self.two.drops());
            self.talk(1, &mut attack);
        }
        self.withstand(attack);
        for link in [&self.one, &self.two] {
            let known = [Reason::Forged, Reason::Stranger, Reason::Undecodable, Reason::Unsealed, Reason::Old];
            assert_eq!(link.ear.refused().iter().find(|kind| !known.contains(&kind.reason)), None);
        }
    }
}

fn secured(tls: Tls) -> Security {
    Security::Tls(tls)
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

/// Makes things up.
struct Forger {
    voices: Voices,
    sealer: Arc<Sealer>,
}

impl Forger {
    /// Says in everybody's name what can be said.
    fn forge(&self, session: &Session, senders: &[u8]) {
        for &sender in senders {
            let header = forged_header(sender);
            self.say(session, Topic::State(id(sender), Cell::default()), &State { header, ..state(sender, 1) });
            self.say(session, Topic::Mission(id(sender)), &Mission { header, ..mission(sender, 1) });
            self.say(session, Topic::Event(id(sender)), &Event { header, what: Happening::Landed });
            say(session, &Topic::Health(id(sender)).key(), b"not even that");
        }
    }

    fn say(&self, session: &Session, topic: Topic, message: &impl Message) {
        say(session, &topic.key(), &self.voices.write(Some(&self.sealer), 0, &topic.key(), message));
        say(session, &topic.key(), &encode(message));
    }
}

/// Orders what nobody has sealed.
fn forge_order(session: &Session) {
    say(session, &Topic::Order(FORGER).key(), &encode(&forged_order()));
}

fn forged_order() -> Order {
    Order { epoch: 9, issuer: FORGER, verb: Verb::Land, seal: None }
}

/// All of it at once.
fn attack(session: &Session, forger: &Forger) {
    forger.forge(session, &[1, 2, NOBODY]);
    forge_order(session);
    forge_tokens(session, &[1, 2]);
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

/// What the other tests rely on: without seals everything that is made up is heard.
#[test]
fn without_seals_a_valid_node_could_say_anything() {
    let swarm = Swarm::without_seals("unsealed");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3.2"));
    let forger = Forger { voices: Voices::plain(swarm.name.clone()), sealer: swarm.authority.sealer("vehicle-3.2") };
    wait_until(|| is_linked(intruder.first()));
    let mut heard = Vec::new();
    let deadline = now() + PATIENCE;
    let kinds: [fn(&Word) -> bool; 3] = [
        |word| matches!(word, Word::State(_)),
        |word| matches!(word, Word::Mission(_)),
        |word| matches!(word, Word::Order(_)),
    ];
    let is_heard =
        |heard: &[Heard]| kinds.iter().all(|kind| word(heard, |word| is_forged(word) && kind(word)).is_some());
    while !is_heard(&heard) {
        assert!(now() < deadline, "{heard:?}");
        forger.forge(intruder.first(), &[1, 2]);
        forge_order(intruder.first());
        swarm.one.drain(&mut heard);
        pause();
    }
}

#[test]
fn whoever_is_invited_takes_part_fully() {
    let mut swarm = Swarm::begin("honest");
    let observer = swarm.guest(swarm.authority.tls("observer"));
    let operator = swarm.guest(swarm.authority.tls("operator"));
    let observer = observer.first();
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
    let order = seal::orders::seal(&swarm.authority.sealer("operator"), &swarm.name, 0, order);
    for link in [&swarm.one, &swarm.two] {
        let give = || say(operator.first(), &Topic::Order(9).key(), &encode(&order));
        until(link, give, |heard| word(heard, |word| *word == Word::Order(order)));
    }
}

#[test]
fn a_late_vehicle_has_the_registers_of_the_others() {
    let swarm = Swarm::begin("late-secured");
    swarm.one.say_mission(&mission(1, 5));
    let trust = swarm.authority.trust(&swarm.name, "vehicle-3.2");
    let late = Link::new(swarm.guest(swarm.authority.tls("vehicle-3.2")), id(3), LocalClock::start(), trust).unwrap();
    until(&late, || {}, |heard| word(heard, |word| *word == Word::Mission(mission(1, 5))));
    until(&swarm.two, || {}, |heard| word(heard, |word| *word == Word::Appeared(id(3))));
}

#[test]
fn who_has_no_certificate_is_not_let_in() {
    let mut swarm = Swarm::begin("none");
    // To the right place in the clear, and in TLS without showing anything.
    let address = swarm.endpoints[0].trim_start_matches("tls/").to_owned();
    let plain = open_zenoh(&swarm.name, &[], &[format!("tcp/{address}")], &[]).unwrap();
    // Not even the right seal helps.
    let forger = swarm.forger("vehicle-1");
    swarm.never_hear(|| attack(&plain, &forger));
    assert!(!is_linked(&plain));

    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(swarm.authority.folder.path().join("authority.pem")).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()));
    let config = config.with_protocol_versions(&[&TLS13]).unwrap().with_root_certificates(roots).with_no_client_auth();
    let mut tls = ClientConnection::new(Arc::new(config), "127.0.0.1".try_into().unwrap()).unwrap();
    let mut socket = TcpStream::connect(address).unwrap();
    let ended = Stream::new(&mut tls, &mut socket).read(&mut [0; 1]);
    assert!(ended.is_err(), "{ended:?}");
    wait_until(|| swarm.one.ear.refused().iter().any(|kind| kind.reason == Reason::Link));
}

#[test]
fn a_certificate_of_another_authority_is_worth_nothing() {
    let mut swarm = Swarm::begin("other");
    // It would take the swarm for its own, if the swarm took it.
    let others = Authority::new();
    let tls = Tls { authority: swarm.authority.folder.path().join("authority.pem"), ..others.tls("vehicle-3.2") };
    let intruder = swarm.guest(tls);
    let forger = swarm.forger("vehicle-1");
    swarm.never_hear(|| attack(intruder.first(), &forger));
    assert!(!is_linked(intruder.first()));
}

#[test]
fn an_expired_certificate_is_worth_nothing() {
    let mut swarm = Swarm::begin("expired");
    let tls = swarm.authority.tls("vehicle-3.2");
    swarm.authority.certify("vehicle-3.2", 2021);
    let intruder = swarm.guest(tls);
    let forger = swarm.forger("vehicle-1");
    swarm.never_hear(|| attack(intruder.first(), &forger));
    assert!(!is_linked(intruder.first()));
}

#[test]
fn a_name_that_was_replaced_is_not_let_in() {
    let mut swarm = Swarm::begin("revoked");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3"));
    let forger = swarm.forger("vehicle-1");
    swarm.never_hear(|| attack(intruder.first(), &forger));
    assert!(!is_linked(intruder.first()));
    assert!(swarm.one.drops().links > 0 && swarm.two.drops().links > 0, "it is told to them, and counted");
}

/// What vehicle 3 says in its own name arrives, so that what it has said before in another's has been refused.
#[test]
fn a_valid_vehicle_speaks_for_itself_alone() {
    let mut swarm = Swarm::begin("branch");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3.2"));
    wait_until(|| is_linked(intruder.first()));
    let forger = swarm.forger("vehicle-3.2");
    let mut said = 0;
    for receiver in [1, 2] {
        for _ in 0..5 {
            attack(intruder.first(), &forger);
            said += 1;
            let link = if receiver == 1 { &swarm.one } else { &swarm.two };
            let heard = until(
                link,
                || forger.say(intruder.first(), Topic::State(id(3), Cell::default()), &state(3, said)),
                |heard| word(heard, |word| *word == Word::State(state(3, said))).map(|_| heard.to_vec()),
            );
            assert_eq!(heard.iter().find(|heard| is_forged(&heard.word)), None);
        }
    }
    swarm.refuse(|| attack(intruder.first(), &forger));
}

/// Whoever comes late asks for registers; what vehicle 3 answers for others is not believed.
#[test]
fn a_valid_vehicle_answers_for_itself_alone() {
    let swarm = Swarm::begin("reply");
    swarm.one.say_mission(&mission(1, 5));
    let own = swarm.authority.tls("vehicle-3.2");
    let forger = swarm.forger("vehicle-3.2");
    let intruder = Sessions::open(&swarm.name, &["tls/127.0.0.1:0".to_owned()], &[], &secured(own)).unwrap();
    let answer = move |query: zenoh::query::Query| {
        for sender in [1, 3] {
            let said = Mission { header: forged_header(sender), ..mission(sender, 1) };
            let key = Topic::Mission(id(sender)).key();
            // Zenoh refuses what was not asked for.
            let _ = query.reply(&key, forger.voices.write(Some(&forger.sealer), 0, &key, &said)).wait();
        }
    };
    // It says that it answers for all of them.
    let _answers =
        intruder.first().declare_queryable("vehicle/*/mission").complete(true).callback(answer).wait().unwrap();
    let _token = intruder.first().liveliness().declare_token(Topic::Alive(id(3)).key()).wait().unwrap();
    let dial = [&swarm.endpoints[..1], &intruder.endpoints()].concat();
    let sessions = Sessions::open(&swarm.name, &[], &dial, &secured(swarm.authority.tls("vehicle-2"))).unwrap();
    let trust = swarm.authority.trust(&swarm.name, "vehicle-2");
    let late = Link::new(sessions, id(2), LocalClock::start(), trust).unwrap();
    // Asked again and again, for the intruder may have been linked later than vehicle 1.
    let ask = || {
        for sender in [1, 3] {
            let ear = late.ear.clone();
            register::ask(late.sessions.first(), Topic::Mission(id(sender)), &[], move |said| {
                ear.hear(said, Word::Mission)
            });
        }
    };
    let heard = until(&late, ask, |heard| {
        (late.drops().forged > 0).then_some(())?;
        word(heard, |word| *word == Word::Mission(mission(1, 5)))?;
        word(heard, |word| is_forged(word) && word.speaker() == Some(id(3))).map(|_| heard.to_vec())
    });
    assert_eq!(word(&heard, |word| is_forged(word) && word.speaker() == Some(id(1))), None);
}

#[test]
fn observers_and_operators_speak_for_no_vehicle() {
    for who in ["observer", "operator"] {
        let mut swarm = Swarm::begin(&format!("{who}-says"));
        let intruder = swarm.guest(swarm.authority.tls(who));
        wait_until(|| is_linked(intruder.first()));
        let forger = swarm.forger(who);
        swarm.refuse(|| attack(intruder.first(), &forger));
    }
}

/// Vehicle 3 keeps what vehicle 1 has said, and says it again when vehicle 1 is gone, to one who never heard it.
#[test]
fn what_was_said_is_worth_nothing_once_its_speaker_is_gone() {
    let swarm = Swarm::begin("replay");
    let intruder = swarm.guest(swarm.authority.tls("vehicle-3.2"));
    let kept = intruder.first().declare_subscriber("vehicle/1/**").wait().unwrap();
    let deadline = now() + PATIENCE;
    let mut words = Vec::new();
    while words.len() < 2 {
        assert!(now() < deadline);
        swarm.one.say_mission(&mission(1, 1));
        words.extend(
            kept.drain().map(|sample| (sample.key_expr().to_string(), sample.payload().to_bytes().into_owned())),
        );
        pause();
    }
    let Swarm { one, two, authority, name, .. } = swarm;
    one.close();
    until(&two, || {}, |heard| word(heard, |word| *word == Word::Vanished(id(1))));
    two.close();
    let here = ["tls/127.0.0.1:0".to_owned()];
    let sessions = Sessions::open(&name, &here, &[], &secured(authority.tls("vehicle-2"))).unwrap();
    let dial = sessions.endpoints();
    let newcomer = Link::new(sessions, id(2), LocalClock::start(), authority.trust(&name, "vehicle-2")).unwrap();
    let again = Sessions::open(&name, &[], &dial, &secured(authority.tls("vehicle-3.2"))).unwrap();
    let again = again.first();
    let mut heard = Vec::new();
    let deadline = now() + PATIENCE;
    while newcomer.drops().old < 20 {
        assert!(now() < deadline, "{:?}", newcomer.drops());
        words.iter().for_each(|(key, bytes)| say(again, key, bytes));
        drop(again.liveliness().declare_token(Topic::Alive(id(1)).key()).wait().unwrap());
        newcomer.drain(&mut heard);
        pause();
    }
    assert_eq!(word(&heard, |word| word.speaker() == Some(id(1))), None);
}

/// Zenoh knows a session by a number that everybody is shown who is linked to it.
#[test]
fn nobody_takes_anothers_place_by_its_number() {
    let mut swarm = Swarm::begin("number");
    let all = [&swarm.one, &swarm.two].map(|link| link.sessions.all.iter().map(|session| session.zid().to_string()));
    let [ones, twos] = all.map(Iterator::collect::<Vec<_>>);
    let valid = swarm.authority.tls("vehicle-3.2");
    let forger = swarm.forger("vehicle-3.2");
    let intruders: Vec<_> = [(&ones, 1), (&twos, 0)]
        .into_iter()
        .flat_map(|(numbers, victim)| numbers.iter().map(move |number| (number, victim)))
        .map(|(number, victim)| as_number(&swarm, number, &[], &swarm.endpoints[victim..=victim], &valid))
        .collect();
    assert_eq!(intruders.len(), 3, "vehicle 1 dials nobody");
    swarm.withstand(|| intruders.iter().for_each(|intruder| attack(intruder.first(), &forger)));
}

/// A node that is dialled can still take the number of another that is, and so comes to speak over that one's session: in
/// its own seal.
#[test]
fn nobody_speaks_for_another_by_its_number() {
    let swarm = Swarm::begin("voice");
    let free = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap();
    let of_intruder = vec![format!("tls/{free}")];
    let dial = [&swarm.endpoints[..1], &of_intruder].concat();
    let tls = swarm.authority.tls("vehicle-3.2");
    let sessions = Sessions::open(&swarm.name, &["tls/127.0.0.1:0".to_owned()], &dial, &secured(tls)).unwrap();
    let trust = swarm.authority.trust(&swarm.name, "vehicle-3.2");
    let three = Link::new(sessions, id(3), LocalClock::start(), trust).unwrap();
    until(&three, || {}, |heard| word(heard, |word| *word == Word::Appeared(id(1))));

    let number = swarm.one.sessions.first().zid().to_string();
    let intruder = as_number(&swarm, &number, &of_intruder, &[], &swarm.authority.tls("vehicle-2"));
    let forger = swarm.forger("vehicle-2");
    let mut heard = Vec::new();
    let deadline = now() + PATIENCE;
    while three.drops().forged < 20 {
        assert!(now() < deadline, "{:?}", three.drops());
        forger.forge(intruder.first(), &[1]);
        three.drain(&mut heard);
        pause();
    }
    assert_eq!(word(&heard, is_forged), None);
}

/// Somebody who has chosen the number of its session.
fn as_number(swarm: &Swarm, number: &str, listen: &[String], dial: &[String], tls: &Tls) -> Sessions {
    let chosen = [("id", json!(number))];
    let tunnel = Tunnel::open(listen, dial, tls).unwrap();
    Sessions::secured(tunnel, |listen, dial| open_zenoh(&swarm.name, listen, dial, &chosen)).unwrap()
}

/// Peers hand nothing on, but a router would, if they listened to it.
#[test]
fn a_router_is_nobody_special() {
    let mut swarm = Swarm::begin("router");
    let router = [("mode", json!("router"))];
    let tunnel = Tunnel::open(&[], &swarm.endpoints, &swarm.authority.tls("vehicle-3.2")).unwrap();
    let intruder = Sessions::secured(tunnel, |listen, dial| open_zenoh(&swarm.name, listen, dial, &router)).unwrap();
    let forger = swarm.forger("vehicle-3.2");
    swarm.withstand(|| attack(intruder.first(), &forger));
}

#[test]
fn keys_that_are_none_are_named() {
    let authority = Authority::new();
    let name = SwarmName::new("named").unwrap();
    let good = authority.tls("vehicle-1");
    let refused = |tls: Tls, listen: &str| {
        let Err(error) = Sessions::open(&name, &[listen.to_owned()], &[], &secured(tls)) else {
            panic!("it is opened")
        };
        error.to_string()
    };
    let here = "tls/127.0.0.1:0";
    let missing = authority.folder.path().join("missing.pem");
    let named = missing.display().to_string();
    let error = refused(Tls { certificate: missing, ..good.clone() }, here);
    assert!(error.starts_with(&named) && error.contains("No such file"), "{error}");
    let error = refused(Tls { key: good.certificate.clone(), ..good.clone() }, here);
    assert!(error.ends_with("vehicle-1.pem: no PRIVATE KEY in it"), "{error}");
    let error = refused(good.clone(), "tcp/127.0.0.1:0");
    assert_eq!(error, "\"tcp/127.0.0.1:0\": links are secured here, so an endpoint is written like tls/10.0.0.11:7447");
    let Err(error) = Sessions::open(&name, &[], &[here.to_owned()], &Security::Plain) else { panic!("it is opened") };
    assert!(error.is_the_users() && error.to_string().contains("no keys for secured links"), "{error}");
    let mut vehicles = good.vehicles.clone();
    vehicles.insert(id(4), vehicles[&id(1)].clone());
    assert!(refused(Tls { vehicles, ..good.clone() }, here).contains("\"vehicle-1\" has to stand for one"));
    assert!(refused(Tls { observer: "vehicle-2".to_owned(), ..good.clone() }, here).contains("\"vehicle-2\" has to"));
    let other = authority.key_file("vehicle-2");
    assert!(refused(Tls { key: other, ..good.clone() }, here).contains("vehicle-2.key: "), "of another certificate");

    let sealer = |tls: Tls, own: u8| secured(tls).sealer(id(own));
    assert!(sealer(good.clone(), 1).unwrap().is_some() && Security::Plain.sealer(id(1)).unwrap().is_none());
    let error = sealer(good.clone(), 2).unwrap_err();
    assert!(error.is_the_users() && error.to_string() == "the swarm does not know vehicle 2 by this key", "{error}");
    let error = sealer(Tls { key: good.certificate.clone(), ..good }, 1).unwrap_err().to_string();
    assert!(error.ends_with("vehicle-1.pem: not an Ed25519 key in PKCS#8"), "{error}");
}

#[test]
fn links_over_ipv6_are_secured_too() {
    let authority = Authority::new();
    let name = SwarmName::new(format!("six-{}", process::id())).unwrap();
    let tls = |number| secured(authority.tls(&format!("vehicle-{number}")));
    if TcpListener::bind("[::1]:0").is_err() {
        // A machine without IPv6.
        return;
    }
    let one = Sessions::open(&name, &["tls/[::1]:0".to_owned()], &[], &tls(1)).unwrap();
    let two = Sessions::open(&name, &[], &one.endpoints(), &tls(2)).unwrap();
    wait_until(|| is_linked(two.first()));
}

/// Whoever comes and goes while everybody speaks harms nobody: with links of Zenoh's own this ended the process within seconds.
#[test]
fn links_that_come_and_go_harm_nobody() {
    const GUESTS: usize = 3;
    const VISITS: usize = 12;
    let name = SwarmName::new(format!("busy-{}", process::id())).unwrap();
    let authority = Authority::new();
    let here = ["tls/127.0.0.1:0".to_owned()];
    let (mut endpoints, mut links) = (Vec::new(), Vec::new());
    for (own, vehicle) in (1..).zip(["vehicle-1", "vehicle-2", "vehicle-3.2"]) {
        let sessions = Sessions::open(&name, &here, &endpoints, &secured(authority.tls(vehicle))).unwrap();
        endpoints.extend(sessions.endpoints());
        links.push((own, Link::new(sessions, id(own), LocalClock::start(), authority.trust(&name, vehicle)).unwrap()));
    }
    let observer = secured(authority.tls("observer"));
    let (name, endpoints, observer) = (&name, &endpoints, &observer);
    let still_come = &AtomicUsize::new(GUESTS);
    let all_went = || still_come.load(Relaxed) == 0;
    std::thread::scope(|scope| {
        for (own, mut link) in links {
            scope.spawn(move || {
                let (mut said, mut heard) = (0, Vec::new());
                while !all_went() {
                    said += 1;
                    link.say_state(&state(own, said), Cell::default());
                    link.say_mission(&mission(own, said));
                    pause();
                    link.drain(&mut heard);
                }
                let others = [1, 2, 3].into_iter().filter(|other| *other != own);
                for other in others {
                    let is_others = |word: &Word| matches!(word, Word::State(_)) && word.speaker() == Some(id(other));
                    assert!(word(&heard, is_others).is_some(), "{own} hears {other}");
                }
                assert_eq!(link.drops().refused(), 0);
            });
        }
        for _ in 0..GUESTS {
            scope.spawn(move || {
                let _gone = Gone(still_come);
                for _ in 0..VISITS {
                    let sessions = Sessions::open(name, &[], endpoints, observer).unwrap();
                    let heard = sessions.first().declare_subscriber(all::STATES).wait().unwrap();
                    wait_until(|| heard.drain().count() > 0);
                    drop(heard);
                    sessions.close(());
                }
            });
        }
    });
}

/// Takes itself off a count, also when a test fails.
struct Gone<'a>(&'a AtomicUsize);

impl Drop for Gone<'_> {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Relaxed);
    }
}
