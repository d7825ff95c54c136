//! Orders that only an operator can have given: sealed with a key that no node has.
//!
//! An order spreads from register to register, so a vehicle's own seal on its register does not tell whose the order is: any
//! node could make one up and say that it had heard it. So the operator signs it, and every agent checks that before the core
//! sees it.

use std::sync::{Mutex, PoisonError};

use skein_common::id::SwarmName;
use skein_common::message::{Order, Verb};

use super::{SealKey, Sealer};

/// Nothing else that anybody signs with this key begins like this.
const CONTEXT: &[u8] = b"skein order v1\0";

/// Answers that are kept. Every peer repeats the same order five times a second; there are rarely two that matter.
const KEPT: usize = 16;

/// What is signed: everything that an order says, and where it holds. Every field has a fixed length.
fn signed(swarm: &SwarmName, run: u64, order: &Order) -> Vec<u8> {
    let (verb, step) = match order.verb {
        Verb::Hold => (0, 0),
        Verb::Land => (1, 0),
        Verb::Goto(step) => (2, step),
        Verb::Abort => (3, 0),
    };
    let mut bytes = super::signed(CONTEXT, swarm, run);
    bytes.extend(order.epoch.to_le_bytes());
    bytes.extend(order.issuer.to_le_bytes());
    bytes.push(verb);
    bytes.extend(step.to_le_bytes());
    bytes
}

/// Whether an operator of this swarm, known by this key, has given this order in this run. Takes some 100 µs.
pub fn is_sealed(key: &SealKey, swarm: &SwarmName, run: u64, order: &Order) -> bool {
    order.seal.is_some_and(|seal| key.has_sealed(&signed(swarm, run, order), seal))
}

/// The order, sealed for this run of this swarm.
pub fn seal(sealer: &Sealer, swarm: &SwarmName, run: u64, order: Order) -> Order {
    Order { seal: Some(sealer.seal(&signed(swarm, run, &order))), ..order }
}

/// Tells an operator's orders, the same few again and again, at no cost.
#[derive(Debug)]
pub struct Checker {
    key: SealKey,
    swarm: SwarmName,
    /// The latest answers: whether this order is one in this run.
    known: Mutex<Vec<(u64, Order, bool)>>,
}

impl Checker {
    /// By this key, in this swarm.
    pub fn new(key: SealKey, swarm: SwarmName) -> Self {
        Self { key, swarm, known: Mutex::new(Vec::with_capacity(KEPT)) }
    }

    /// Whether an operator has given this order in this run.
    pub fn is_sealed(&self, run: u64, order: &Order) -> bool {
        // Nothing that holds the lock can panic half way.
        let known = || self.known.lock().unwrap_or_else(PoisonError::into_inner);
        let answer = known().iter().find(|(of, known, _)| (*of, known) == (run, order)).map(|(.., answer)| *answer);
        answer.unwrap_or_else(|| {
            let answer = is_sealed(&self.key, &self.swarm, run, order);
            let mut known = known();
            if known.len() == KEPT {
                known.remove(0);
            }
            known.push((run, *order, answer));
            answer
        })
    }
}

#[cfg(test)]
mod tests {
    use skein_common::message::Seal;

    use super::super::tests::{name, sealer};
    use super::*;

    const ORDER: Order = Order { epoch: 5, issuer: 9, verb: Verb::Goto(2), seal: None };

    #[test]
    fn a_seal_holds_for_one_order_in_one_run_of_one_swarm() {
        let (operator, lab) = (sealer(), name("lab"));
        let (key, sealed) = (operator.key(), seal(&operator, &lab, 7, ORDER));
        assert_eq!(Order { seal: None, ..sealed }, ORDER);
        assert!(is_sealed(&key, &lab, 7, &sealed));
        assert!(!is_sealed(&key, &lab, 7, &ORDER), "without a seal");
        assert!(!is_sealed(&key, &lab, 8, &sealed), "in another run");
        assert!(!is_sealed(&key, &name("lab2"), 7, &sealed), "in another swarm");
        let others = [
            Order { epoch: 6, ..sealed },
            Order { issuer: 10, ..sealed },
            Order { verb: Verb::Goto(3), ..sealed },
            Order { verb: Verb::Abort, ..sealed },
            Order { seal: Some(Seal::from_bytes([0; Seal::BYTES])), ..sealed },
        ];
        for other in others {
            assert!(!is_sealed(&key, &lab, 7, &other), "{other:?}");
        }
        assert!(!is_sealed(&sealer().key(), &lab, 7, &sealed), "by another operator");
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

    #[test]
    fn what_was_checked_is_known_and_nothing_grows() {
        let (operator, lab) = (sealer(), name("lab"));
        let checker = Checker::new(operator.key(), lab.clone());
        let sealed = |epoch| seal(&operator, &lab, 7, Order { epoch, ..ORDER });
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
}
