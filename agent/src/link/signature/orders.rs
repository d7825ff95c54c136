//! Orders that only an operator can have given: signed with a key that no node has.
//!
//! Vehicles pass an order on in their heartbeats, so a vehicle's own signature does not prove that an operator gave the
//! order: any node could invent an order and claim to have received it. The operator therefore signs it, and every
//! agent verifies that signature before the core gets the order.

use parking_lot::Mutex;
use skein_common::id::{SwarmName, VehicleId};
use skein_common::message::{Order, Verb};
use skein_common::scenario::TunableKey;
use skein_common::topic::Branch;

use super::{SigningKey, VerificationKey};

/// Marks a signed order; nothing else signed with this key starts like this.
const CONTEXT: &[u8] = b"skein order v2\0";

/// Number of verified orders kept. Every peer repeats five times a second one of the orders in force, of which there may be
/// one for each vehicle and one for each key.
const KEPT: usize = VehicleId::MAX as usize + TunableKey::ALL.len() + 6;

/// The signed bytes: the order's content, swarm and run, and in a fleet its team, so that an order to one team is
/// refused by the others. Every field has a fixed length; an order to the whole swarm has no bit set for a vehicle. Only an
/// order that sets a key has the key's value.
fn signed_bytes(swarm: &SwarmName, branch: Branch, run: u64, order: &Order) -> Vec<u8> {
    let (verb, step) = match order.verb {
        Verb::Hold => (0, 0),
        Verb::Land => (1, 0),
        Verb::Goto(step) => (2, step),
        Verb::Abort => (3, 0),
        Verb::Release => (4, 0),
        Verb::Set(setting) => (5, setting.key as u32),
    };
    let mut bytes = super::signed_prefix(CONTEXT, swarm, run);
    bytes.extend(order.epoch.to_le_bytes());
    bytes.extend(order.issuer.to_le_bytes());
    bytes.push(verb);
    bytes.extend(step.to_le_bytes());
    bytes.extend(order.vehicles.unwrap_or_default().to_bytes());
    if let Verb::Set(setting) = order.verb {
        bytes.extend(setting.value.to_bits().to_le_bytes());
    }
    bytes.extend(branch.team().into_iter().flat_map(|team| team.get().to_le_bytes()));
    bytes
}

/// Signs the order for this run of this swarm.
pub fn sign(signing_key: &SigningKey, swarm: &SwarmName, branch: Branch, run: u64, order: Order) -> Order {
    Order { signature: Some(signing_key.sign(&signed_bytes(swarm, branch, run, &order))), ..order }
}

/// Verifies orders, and remembers the latest results so that a repeated order costs nothing.
#[derive(Debug)]
pub struct Checker {
    key: VerificationKey,
    swarm: SwarmName,
    branch: Branch,
    /// The latest results: whether this order is valid in this run.
    known: Mutex<Vec<(u64, Order, bool)>>,
}

impl Checker {
    /// Verifies orders of this swarm by this key.
    pub fn new(key: VerificationKey, swarm: SwarmName, branch: Branch) -> Self {
        Self { key, swarm, branch, known: Mutex::new(Vec::with_capacity(KEPT)) }
    }

    /// Number of orders whose result is remembered.
    pub fn known(&self) -> usize {
        self.known.lock().len()
    }

    /// Whether the operator gave this order in this run. Takes about 100 µs for the first time.
    pub fn is_signed(&self, run: u64, order: &Order) -> bool {
        let known = self.known.lock();
        let answer = known.iter().find(|(of, known, _)| (*of, known) == (run, order)).map(|(.., answer)| *answer);
        // Verifying takes long: the lock is not held for it.
        drop(known);
        answer.unwrap_or_else(|| {
            let bytes = signed_bytes(&self.swarm, self.branch, run, order);
            let answer = order.signature.is_some_and(|signature| self.key.has_signed(&bytes, signature));
            let mut known = self.known.lock();
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
    use skein_common::id::TeamId;
    use skein_common::message::Signature;

    use super::super::tests::{name, signing_key};
    use super::*;

    const ORDER: Order = Order { epoch: 5, issuer: 9, verb: Verb::Goto(2), vehicles: None, signature: None };

    fn is_signed(key: &VerificationKey, swarm: &SwarmName, branch: Branch, run: u64, order: &Order) -> bool {
        Checker::new(*key, swarm.clone(), branch).is_signed(run, order)
    }

    fn team(number: u16) -> Branch {
        Branch::of(Some(TeamId::new(number).unwrap()))
    }

    #[test]
    fn a_signature_is_valid_for_one_order_in_one_run_of_one_swarm() {
        let (operator, lab) = (signing_key(), name("lab"));
        let (key, signed) = (operator.key(), sign(&operator, &lab, Branch::SWARM, 7, ORDER));
        assert_eq!(Order { signature: None, ..signed }, ORDER);
        assert!(is_signed(&key, &lab, Branch::SWARM, 7, &signed));
        assert!(!is_signed(&key, &lab, Branch::SWARM, 7, &ORDER), "not signed");
        assert!(!is_signed(&key, &lab, Branch::SWARM, 8, &signed), "in another run");
        assert!(!is_signed(&key, &lab, team(1), 7, &signed), "to a team");
        let to_team = sign(&operator, &lab, team(1), 7, ORDER);
        assert!(is_signed(&key, &lab, team(1), 7, &to_team));
        assert!(!is_signed(&key, &lab, team(2), 7, &to_team) && !is_signed(&key, &lab, Branch::SWARM, 7, &to_team));
        assert!(!is_signed(&key, &name("lab2"), Branch::SWARM, 7, &signed), "in another swarm");
        let others = [
            Order { epoch: 6, ..signed },
            Order { issuer: 10, ..signed },
            Order { verb: Verb::Goto(3), ..signed },
            Order { verb: Verb::Abort, ..signed },
            Order { vehicles: Some([VehicleId::new(1).unwrap()].into_iter().collect()), ..signed },
            Order { signature: Some(Signature::from_bytes([0; Signature::BYTES])), ..signed },
        ];
        for other in others {
            assert!(!is_signed(&key, &lab, Branch::SWARM, 7, &other), "{other:?}");
        }
        let set = |text: &str| Verb::Set(text.parse().unwrap());
        let sets = sign(&operator, &lab, team(1), 7, Order { verb: set("formation.radius_m=80"), ..ORDER });
        assert!(is_signed(&key, &lab, team(1), 7, &sets) && !is_signed(&key, &lab, Branch::SWARM, 7, &sets));
        for text in ["formation.radius_m=81", "formation.altitude_m=80"] {
            assert!(!is_signed(&key, &lab, team(1), 7, &Order { verb: set(text), ..sets }), "{text}");
        }
        assert!(!is_signed(&signing_key().key(), &lab, Branch::SWARM, 7, &signed), "signed by another operator");
    }

    /// The signed bytes are part of the protocol.
    #[test]
    fn the_signed_bytes_are_exactly_these() {
        let mut golden = b"skein order v2\0".to_vec();
        golden.extend([3, 0, 0, 0, 0, 0, 0, 0]);
        golden.extend(b"lab");
        golden.extend([7, 0, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 0, 0, 0, 0, 9, 0, 0, 0, 0, 0, 0, 0, 2, 2, 0, 0, 0]);
        golden.extend([0; 32]);
        assert_eq!(signed_bytes(&name("lab"), Branch::SWARM, 7, &ORDER), golden);
        golden.extend([3, 1]);
        assert_eq!(signed_bytes(&name("lab"), team(259), 7, &ORDER), golden);
        let vehicles = [1, 10].map(|number| VehicleId::new(number).unwrap()).into_iter().collect();
        let named = signed_bytes(&name("lab"), team(259), 7, &Order { vehicles: Some(vehicles), ..ORDER });
        let at = golden.len() - 34;
        golden[at..at + 2].copy_from_slice(&[1, 2]);
        assert_eq!(named, golden);

        let verb = Verb::Set("formation.altitude_m=80".parse().unwrap());
        let sets = signed_bytes(&name("lab"), team(259), 7, &Order { verb, ..ORDER });
        golden[at - 5..at + 2].copy_from_slice(&[5, TunableKey::Altitude as u8, 0, 0, 0, 0, 0]);
        golden.splice(golden.len() - 2.., 80.0_f64.to_le_bytes().into_iter().chain([3, 1]));
        assert_eq!(sets, golden);
    }

    #[test]
    fn verified_orders_are_remembered_in_bounded_memory() {
        let (operator, lab) = (signing_key(), name("lab"));
        let checker = Checker::new(operator.key(), lab.clone(), Branch::SWARM);
        let signed = |epoch| sign(&operator, &lab, Branch::SWARM, 7, Order { epoch, ..ORDER });
        for epoch in 0..200 {
            assert!(checker.is_signed(7, &signed(epoch)));
            assert!(!checker.is_signed(8, &signed(epoch)));
        }
        let known = || checker.known.lock().clone();
        let before = known();
        assert_eq!(before.len(), KEPT);
        assert!(checker.is_signed(7, &signed(199)) && !checker.is_signed(8, &signed(199)));
        assert_eq!(known(), before, "not verified again");
    }
}
