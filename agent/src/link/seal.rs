//! Orders that only an operator can have given: sealed with a key that no node has.
//!
//! An order spreads from register to register, so access control cannot tell whose it is: any node could make one up and
//! say that it had heard it. So the operator signs it (Ed25519, RFC 8032), and every agent checks that before the core
//! sees it. A seal holds in one run of one swarm: yesterday's orders, or another swarm's, are worth nothing today.

use std::fmt;
use std::sync::{Mutex, PoisonError};

use ring::signature::{ED25519, Ed25519KeyPair, KeyPair, UnparsedPublicKey};
use skein_common::id::SwarmName;
use skein_common::message::{Order, Seal, Verb};

/// Nothing else that anybody signs with this key begins like this.
const CONTEXT: &[u8] = b"skein order v1\0";

/// Answers that are kept. Every peer repeats the same order five times a second; there are rarely two that matter.
const KEPT: usize = 16;

/// A private key that is none.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("not an Ed25519 key in PKCS#8")]
pub struct NotAKey;

/// What is signed: everything that an order says, and where it holds. Every field but the name has a fixed length, and the
/// name's stands before it: no two orders have the same bytes.
fn signed(swarm: &SwarmName, run: u64, order: &Order) -> Vec<u8> {
    let (verb, step) = match order.verb {
        Verb::Hold => (0, 0),
        Verb::Land => (1, 0),
        Verb::Goto(step) => (2, step),
        Verb::Abort => (3, 0),
    };
    let name = swarm.as_str().as_bytes();
    let mut bytes = CONTEXT.to_vec();
    bytes.extend((name.len() as u64).to_le_bytes());
    bytes.extend(name);
    bytes.extend(run.to_le_bytes());
    bytes.extend(order.epoch.to_le_bytes());
    bytes.extend(order.issuer.to_le_bytes());
    bytes.push(verb);
    bytes.extend(step.to_le_bytes());
    bytes
}

/// The public key by which an order is known for an operator's.
#[derive(Clone, Copy, PartialEq, Eq)]
pub struct OrderKey([u8; 32]);

impl OrderKey {
    /// Whether an operator of this swarm has given this order in this run. Takes some 100 µs.
    pub fn has_sealed(&self, swarm: &SwarmName, run: u64, order: &Order) -> bool {
        order.seal.is_some_and(|seal| {
            let key = UnparsedPublicKey::new(&ED25519, self.0);
            key.verify(&signed(swarm, run, order), &seal.to_bytes()).is_ok()
        })
    }
}

impl fmt::Debug for OrderKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("OrderKey(")?;
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))?;
        f.write_str(")")
    }
}

impl From<OrderKey> for [u8; 32] {
    fn from(key: OrderKey) -> Self {
        key.0
    }
}

impl From<[u8; 32]> for OrderKey {
    fn from(key: [u8; 32]) -> Self {
        Self(key)
    }
}

/// An operator's private key.
pub struct Sealer(Ed25519KeyPair);

impl Sealer {
    /// The key in this PKCS#8 document (DER), with or without its public half.
    ///
    /// # Errors
    /// If it is not one.
    pub fn from_pkcs8(der: &[u8]) -> Result<Self, NotAKey> {
        Ed25519KeyPair::from_pkcs8_maybe_unchecked(der).map(Self).map_err(|_| NotAKey)
    }

    /// What its seals are known by.
    pub fn key(&self) -> OrderKey {
        let mut key = [0; 32];
        key.copy_from_slice(self.0.public_key().as_ref());
        OrderKey(key)
    }

    /// The order, sealed for this run of this swarm.
    pub fn seal(&self, swarm: &SwarmName, run: u64, order: Order) -> Order {
        let mut seal = [0; Seal::BYTES];
        seal.copy_from_slice(self.0.sign(&signed(swarm, run, &order)).as_ref());
        Order { seal: Some(Seal::from_bytes(seal)), ..order }
    }
}

impl fmt::Debug for Sealer {
    /// Never the key.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Sealer(of {:?})", self.key())
    }
}

/// Tells an operator's orders, the same few again and again, at no cost.
#[derive(Debug)]
pub struct Checker {
    key: OrderKey,
    swarm: SwarmName,
    /// The latest answers: whether this order is one in this run.
    known: Mutex<Vec<(u64, Order, bool)>>,
}

impl Checker {
    /// By this key, in this swarm.
    pub fn new(key: OrderKey, swarm: SwarmName) -> Self {
        Self { key, swarm, known: Mutex::new(Vec::with_capacity(KEPT)) }
    }

    /// Whether an operator has given this order in this run.
    pub fn is_sealed(&self, run: u64, order: &Order) -> bool {
        // Nothing that holds the lock can panic half way.
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = known().iter().find(|(of, known, _)| (*of, known) == (run, order)).map(|(.., answer)| *answer);
        answer.unwrap_or_else(|| {
            let answer = self.key.has_sealed(&self.swarm, run, order);
            let mut known = known();
            if known.len() == KEPT {
                known.remove(0);
            }
            known.push((run, *order, answer));
            answer
        })
    }
}

/// The run that most say; of several that as many say, the largest. 0 says nothing, and is what is said where nobody knows.
pub fn most_said_run(runs: impl Iterator<Item = u64>) -> u64 {
    let mut said: Vec<u64> = runs.filter(|&run| run != 0).collect();
    said.sort_unstable();
    let most = said.chunk_by(|one, other| one == other).max_by_key(|same| same.len());
    most.and_then(|same| same.first()).copied().unwrap_or(0)
}

#[cfg(test)]
pub(crate) mod tests {
    use ring::rand::SystemRandom;

    use super::*;

    pub(crate) fn sealer() -> Sealer {
        Sealer::from_pkcs8(Ed25519KeyPair::generate_pkcs8(&SystemRandom::new()).unwrap().as_ref()).unwrap()
    }

    fn name(text: &str) -> SwarmName {
        SwarmName::new(text).unwrap()
    }

    const ORDER: Order = Order { epoch: 5, issuer: 9, verb: Verb::Goto(2), seal: None };

    #[test]
    fn a_seal_holds_for_one_order_in_one_run_of_one_swarm() {
        let (sealer, lab) = (sealer(), name("lab"));
        let (key, sealed) = (sealer.key(), sealer.seal(&lab, 7, ORDER));
        assert_eq!(Order { seal: None, ..sealed }, ORDER);
        assert!(key.has_sealed(&lab, 7, &sealed));
        assert!(!key.has_sealed(&lab, 7, &ORDER), "without a seal");
        assert!(!key.has_sealed(&lab, 8, &sealed), "in another run");
        assert!(!key.has_sealed(&name("lab2"), 7, &sealed), "in another swarm");
        let others = [
            Order { epoch: 6, ..sealed },
            Order { issuer: 10, ..sealed },
            Order { verb: Verb::Goto(3), ..sealed },
            Order { verb: Verb::Abort, ..sealed },
            Order { seal: Some(Seal::from_bytes([0; Seal::BYTES])), ..sealed },
        ];
        for other in others {
            assert!(!key.has_sealed(&lab, 7, &other), "{other:?}");
        }
        assert!(!self::sealer().key().has_sealed(&lab, 7, &sealed), "by another operator");
    }

    /// The bytes under a seal are part of the protocol.
    #[test]
    fn what_is_signed_has_these_bytes() {
        let mut golden = b"skein order v1\0".to_vec();
        golden.extend([3, 0, 0, 0, 0, 0, 0, 0]);
        golden.extend(b"lab");
        golden.extend([7, 0, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 2, 2, 0, 0, 0]);
        assert_eq!(signed(&name("lab"), 7, &ORDER), golden);
    }

    /// RFC 8032, 7.1, test 3.
    #[test]
    fn seals_are_ed25519() {
        let hex = |text: &str| -> Vec<u8> {
            text.as_bytes().chunks(2).map(|two| u8::from_str_radix(str::from_utf8(two).unwrap(), 16).unwrap()).collect()
        };
        let seed = hex("c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7");
        let public = "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025";
        // PKCS#8 version 1 as OpenSSL writes it: a fixed head and the seed.
        let der = [hex("302e020100300506032b657004220420"), seed].concat();
        let sealer = Sealer::from_pkcs8(&der).unwrap();
        assert_eq!(sealer.key(), OrderKey::from(<[u8; 32]>::try_from(hex(public)).unwrap()));
        assert_eq!(format!("{sealer:?}"), format!("Sealer(of OrderKey({public}))"), "and nothing secret");
        assert!(Sealer::from_pkcs8(b"key").is_err());
        let signature = "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a";
        assert_eq!(sealer.0.sign(&[0xaf, 0x82]).as_ref(), hex(signature));
    }

    #[test]
    fn what_was_checked_is_known_and_nothing_grows() {
        let (sealer, lab) = (sealer(), name("lab"));
        let checker = Checker::new(sealer.key(), lab.clone());
        let sealed = |epoch| sealer.seal(&lab, 7, Order { epoch, ..ORDER });
        for epoch in 0..100 {
            assert!(checker.is_sealed(7, &sealed(epoch)));
            assert!(!checker.is_sealed(8, &sealed(epoch)));
        }
        let known = || checker.known.lock().unwrap().clone();
        let before = known();
        assert_eq!(before.len(), KEPT);
        assert!(checker.is_sealed(7, &sealed(99)) && !checker.is_sealed(8, &sealed(99)));
        assert_eq!(known(), before, "not checked again");
    }

    #[test]
    fn the_run_is_what_most_say() {
        let most = |runs: &[u64]| most_said_run(runs.iter().copied());
        assert_eq!((most(&[]), most(&[0, 0])), (0, 0));
        assert_eq!((most(&[0, 0, 5]), most(&[5, 3, 3, 0, 0, 0]), most(&[3, 5])), (5, 3, 5));
    }
}
