//! Secured links: a node with a valid certificate joins the swarm and sends messages of its own vehicle only. The
//! honest vehicles 1 and 2 exchange messages during every attack. Forged messages are marked, and would be received if
//! they got through.

mod links;
mod messages;
mod teams;

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::io::Read;
use std::net::{TcpListener, TcpStream};
use std::sync::atomic::AtomicUsize;

use parking_lot::ReentrantMutex;
use rcgen::{
    BasicConstraints, CertificateParams, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair, PKCS_ED25519,
    date_time_ymd,
};
use rustls_pki_types::CertificateDer;
use rustls_pki_types::pem::PemObject;
use skein_common::message::{EventKind, PeerHealth};
use skein_common::state::PeerStatus;
use tempfile::TempDir;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::version::TLS13;
use tokio_rustls::rustls::{ClientConfig, ClientConnection, RootCertStore, Stream};

use super::security::{PeerIdentity, Tls};
use super::tunnel::Tunnel;
use super::*;

/// Incarnation and issuer that mark all forged messages.
const FORGED: Incarnation = Incarnation(u64::MAX);
const FORGER: u64 = 77;
/// Run of the swarm in all tests.
const RUN: u64 = 7;
/// Id of a vehicle that is not up.
const ABSENT: u8 = 7;
/// Number of message exchanges between the honest vehicles during an attack.
const ROUNDS: u64 = 60;

/// Held by the test whose swarm is under attack: several attacks at once would use up the threads on which Zenoh receives, which all
/// tests of a process share.
static UNDER_ATTACK: ReentrantMutex<()> = ReentrantMutex::new(());

/// Certificate authority of a swarm.
struct Authority {
    folder: TempDir,
    issuer: Issuer<'static, KeyPair>,
}

impl Authority {
    fn new() -> Self {
        // Characters that are separators in some formats and valid in a path.
        let folder = tempfile::Builder::new().prefix("keys = , &").tempdir().unwrap();
        let key = KeyPair::generate().unwrap();
        let mut about = CertificateParams::default();
        about.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        about.distinguished_name.push(DnType::CommonName, "authority");
        let own = about.self_signed(&key).unwrap();
        fs::write(folder.path().join("authority.pem"), own.pem()).unwrap();
        Self { folder, issuer: Issuer::new(about, key) }
    }

    /// Makes a certificate with this common name for the name's key, valid until the end of this year.
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

    fn signing_key(&self, name: &str) -> Arc<SigningKey> {
        Arc::new(SigningKey::from_pem(&fs::read_to_string(self.key_file(name)).unwrap()).unwrap())
    }

    fn tls(&self, name: &str) -> Tls {
        self.certify(name, 2100);
        let file = |name: &str| self.folder.path().join(name);
        Tls {
            authority: file("authority.pem"),
            certificate: file(&format!("{name}.pem")),
            key: self.key_file(name),
            orders: signature::VerificationKey([0; 32]),
            vehicles: self.vehicles(),
            observers: ["observer", "observer-1"].map(str::to_owned).into(),
            operator: "operator".to_owned(),
        }
    }

    /// Known vehicles; vehicle 3's first certificate name was revoked.
    fn vehicles(&self) -> BTreeMap<VehicleName, PeerIdentity> {
        let known = |name: &str| PeerIdentity { name: name.to_owned(), key: self.signing_key(name).key() };
        let names = ["vehicle-1", "vehicle-2", "vehicle-3.2"];
        names.iter().zip(1..).map(|(name, number)| (id(number).into(), known(name))).collect()
    }

    /// Trust of an agent with this certificate.
    fn trust(&self, swarm: &SwarmName, name: &str) -> Trust {
        let security = secured(self.tls(name));
        Trust {
            key_ring: security.key_ring(swarm),
            signing_key: Some(self.signing_key(name)),
            orders: Some(self.signing_key("operator").key()),
            run: RUN,
            ..trust(swarm)
        }
    }
}

/// Two honest vehicles; the second has dialled the first.
struct Swarm {
    name: SwarmName,
    authority: Authority,
    endpoints: Vec<String>,
    one: Link,
    two: Link,
    sequence: u64,
}

impl Swarm {
    fn begin(test: &str) -> Self {
        Self::with(test, |authority, swarm, vehicle| authority.trust(swarm, vehicle))
    }

    /// A swarm whose vehicles require certificates but not signatures.
    fn without_signatures(test: &str) -> Self {
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
        let mut swarm = Self { name, authority, endpoints, one, two, sequence: 0 };
        swarm.exchange(1, || {});
        swarm
    }

    /// Sessions of a guest with this certificate.
    fn guest(&self, tls: Tls) -> Sessions {
        Sessions::open(&self.name, &[], &self.endpoints, &secured(tls)).unwrap()
    }

    /// A forger that signs with this name's key.
    fn forger(&self, name: &str) -> Forger {
        let security = secured(self.authority.tls(name));
        Forger { key_ring: security.key_ring(&self.name), signing_key: self.authority.signing_key(name) }
    }

    /// Lets both vehicles publish states, with `meanwhile` in between, until each has received the other's; repeats
    /// that. Returns everything that they received.
    fn exchange(&mut self, rounds: u64, mut meanwhile: impl FnMut()) -> Vec<Received> {
        let mut all = Vec::new();
        for _ in 0..rounds {
            let mut waits_for: BTreeSet<u8> = [1, 2].into();
            let deadline = now() + TIMEOUT;
            let before = self.sequence;
            while !waits_for.is_empty() {
                assert!(now() < deadline, "no state received by the peers of {waits_for:?}");
                self.sequence += 1;
                self.one.publish_state(&state(1, self.sequence), Cell::default());
                self.two.publish_state(&state(2, self.sequence), Cell::default());
                meanwhile();
                sleep_until(now() + Duration::from_millis(10));
                for (link, other) in [(&self.one, 2), (&self.two, 1)] {
                    let mut received = Vec::new();
                    link.drain(&mut received);
                    // On a busy computer the last one is still on its way.
                    let is_of_round = |message: &PeerMessage| {
                        (before + 1..=self.sequence).any(|sent| *message == received_state(state(other, sent)))
                    };
                    if message(&received, is_of_round).is_some() {
                        waits_for.remove(&other);
                    }
                    all.append(&mut received);
                }
            }
        }
        all
    }

    /// Lets the two exchange messages during an attack, and checks that no forged message is accepted.
    fn withstand(&mut self, mut attack: impl FnMut()) {
        let _one_at_a_time = UNDER_ATTACK.lock();
        let received = self.exchange(ROUNDS, &mut attack);
        assert_eq!(received.iter().find(|received| is_forged(&received.message)), None);
        for vehicle in [1, 2] {
            let comes_or_goes = |message: &PeerMessage| matches!(message, PeerMessage::Appeared(who) | PeerMessage::Vanished(who) if who.get() == vehicle);
            // A link may break on a busy computer, but it must be restored.
            let last = received.iter().rev().find(|received| comes_or_goes(&received.message));
            assert!(!last.is_some_and(|last| matches!(last.message, PeerMessage::Vanished(_))), "{last:?}");
        }
    }

    /// Checks that no forged message is accepted, and that none even reaches our code.
    fn receive_nothing_forged(&mut self, attack: impl FnMut()) {
        self.withstand(attack);
        for link in [&self.one, &self.two] {
            assert_eq!(
                Drops { old: 0, links: 0, ..link.drops() },
                Drops::default(),
                "a forged message reached our code"
            );
        }
    }

    /// Checks that no forged message is accepted, and that of all that is sent both vehicles receive and refuse the orders alone.
    fn refuse_orders_alone(&mut self, mut attack: impl FnMut()) {
        let _one_at_a_time = UNDER_ATTACK.lock();
        let deadline = now() + TIMEOUT;
        while [&self.one, &self.two].iter().any(|link| link.drops().unsigned < 20) {
            assert!(now() < deadline, "{:?}, {:?}", self.one.drops(), self.two.drops());
            self.exchange(1, &mut attack);
        }
        self.withstand(attack);
        for link in [&self.one, &self.two] {
            assert_eq!(Drops { unsigned: 0, old: 0, links: 0, ..link.drops() }, Drops::default());
        }
    }

    /// Checks that no forged message is accepted, and that both vehicles count the forged ones.
    fn refuse(&mut self, mut attack: impl FnMut()) {
        let _one_at_a_time = UNDER_ATTACK.lock();
        let deadline = now() + TIMEOUT;
        while [&self.one, &self.two].iter().any(|link| link.drops().forged < 20) {
            assert!(now() < deadline, "{:?}, {:?}", self.one.drops(), self.two.drops());
            self.exchange(1, &mut attack);
        }
        self.withstand(attack);
        for link in [&self.one, &self.two] {
            let known = [Reason::Forged, Reason::UnknownVehicle, Reason::Undecodable, Reason::Unsealed, Reason::Old];
            assert_eq!(link.receiver.inbox.refusals.latest().iter().find(|kind| !known.contains(&kind.reason)), None);
        }
    }
}

fn secured(tls: Tls) -> Security {
    Security::Tls(tls)
}

fn is_forged(message: &PeerMessage) -> bool {
    match message {
        PeerMessage::State(content) => content.header.incarnation == FORGED,
        PeerMessage::Mission(content) => content.header.incarnation == FORGED,
        PeerMessage::Order(order) => order.issuer == FORGER,
        PeerMessage::Appeared(who) | PeerMessage::Vanished(who) => who.get() == ABSENT,
    }
}

fn forged_header(sender: u8) -> Header {
    Header { incarnation: FORGED, ..state(sender, 1).header }
}

/// Forges messages.
struct Forger {
    key_ring: KeyRing,
    signing_key: Arc<SigningKey>,
}

impl Forger {
    /// Publishes every kind of message in the name of each sender.
    fn forge(&self, session: &Session, senders: &[u8]) {
        for &sender in senders {
            let header = forged_header(sender);
            self.send(session, Topic::State(id(sender), Cell::default()), &State { header, ..state(sender, 1) });
            self.send(session, Topic::Mission(id(sender)), &Heartbeat { header, ..mission(sender, 1) });
            self.send(session, Topic::Event(id(sender)), &Event { header, what: EventKind::Landed });
            send(session, &Topic::Health(id(sender)).key(), b"not a message");
        }
    }

    fn send(&self, session: &Session, topic: Topic, message: &impl Message) {
        send(session, &topic.key(), &self.key_ring.write(Some(&self.signing_key), RUN, &topic.key(), message));
        send(session, &topic.key(), &encode(message));
    }
}

/// Publishes an order without a signature.
fn forge_order(session: &Session) {
    send(session, &Topic::Order(FORGER).key(), &encode(&forged_order()));
}

fn forged_order() -> Order {
    Order { epoch: 9, issuer: FORGER, verb: Verb::Land, vehicles: None, signature: None }
}

/// Forges messages, an order and tokens.
fn attack(session: &Session, forger: &Forger) {
    forger.forge(session, &[1, 2, ABSENT]);
    forge_order(session);
    forge_tokens(session, &[1, 2]);
}

/// Declares and drops tokens of vehicles that are up and of one that is not.
fn forge_tokens(session: &Session, senders: &[u8]) {
    for &sender in senders {
        drop(session.liveliness().declare_token(Topic::Alive(id(sender)).key()).wait().unwrap());
    }
    let absent = session.liveliness().declare_token(Topic::Alive(id(ABSENT)).key());
    drop(absent.wait().unwrap());
}

fn is_linked(session: &Session) -> bool {
    session.info().peers_zid().wait().next().is_some()
}
