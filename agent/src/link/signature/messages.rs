//! Signed messages of vehicles. Each carries a signature with its vehicle's own key, and the receiver looks that key up
//! by the vehicle in the message's topic. A hijacked node can therefore send only its own vehicle's messages, in
//! whatever session.
//!
//! Layout of a signed message: the message, the run of the swarm (8 bytes, little-endian), the signature (64 bytes).
//! The signed bytes are: a context, the swarm's name, the run, the key expression, the message. The sequence number in
//! the message reveals a replay.

use std::collections::BTreeMap;
use std::sync::Arc;

use skein_common::id::{SwarmName, VehicleName};
use skein_common::message::{self, DecodeError, Message, Reason, Signature};
use skein_common::topic::{Author, Branch, Topic};

use super::{SigningKey, VerificationKey};

const CONTEXT: &[u8] = b"skein word v1\0";

/// Number of bytes that the run and the signature add to a message.
pub const ADDED_BYTES: usize = 8 + Signature::BYTES;

/// A message whose sender is verified.
#[derive(Clone, Debug, PartialEq)]
pub struct Verified<M> {
    /// The message.
    pub message: M,
    /// Run of the swarm it was sent in, where messages are signed.
    pub run: Option<u64>,
}

/// The reason why a message is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum VerificationError {
    /// The bytes are not a message.
    #[error(transparent)]
    Undecodable(#[from] DecodeError),
    /// The message names another sender than its key does.
    #[error("sent under the key of another vehicle")]
    OtherName,
    /// The vehicle does not belong to the swarm.
    #[error("sent by a vehicle that is not in this swarm")]
    UnknownVehicle,
    /// The signature is missing or wrong.
    #[error("without a valid signature of its vehicle")]
    NoSeal,
}

impl VerificationError {
    /// The reason under which the refusal is counted.
    pub fn reason(self) -> Reason {
        match self {
            Self::Undecodable(DecodeError::Version(_)) => Reason::OtherVersion,
            Self::Undecodable(_) => Reason::Undecodable,
            Self::OtherName | Self::NoSeal => Reason::Forged,
            Self::UnknownVehicle => Reason::UnknownVehicle,
        }
    }
}

/// Public keys of the vehicles, which verify the sender of each message.
#[derive(Clone, Debug)]
pub struct KeyRing {
    swarm: SwarmName,
    /// `None` on plain links, where messages are not signed.
    keys: Option<Arc<BTreeMap<VehicleName, VerificationKey>>>,
}

impl KeyRing {
    /// Accepts messages without a signature: every sender is believed.
    pub fn plain(swarm: SwarmName) -> Self {
        Self { swarm, keys: None }
    }

    /// Verifies messages with these keys.
    pub fn signed(swarm: SwarmName, keys: BTreeMap<VehicleName, VerificationKey>) -> Self {
        Self { swarm, keys: Some(Arc::new(keys)) }
    }

    /// Decodes a message and verifies its sender. Verifying a signature takes about 100 µs. An order carries an
    /// operator's signature ([`super::orders`]), which is not verified here.
    ///
    /// # Errors
    /// If the bytes are not a message of the sender that the key names.
    pub fn read<M: Message>(&self, key: &str, bytes: &[u8]) -> Result<Verified<M>, VerificationError> {
        let (branch, topic) = Branch::parse(key).ok_or(VerificationError::OtherName)?;
        let keys = match (&self.keys, topic.author()) {
            (Some(keys), Author::Vehicle(id)) => {
                Some(keys.get(&branch.name(id)).ok_or(VerificationError::UnknownVehicle)?)
            }
            _ => None,
        };
        let Some(known_by) = keys else {
            return Ok(Verified { message: own(&topic, bytes)?, run: None });
        };
        let (rest, signature) = bytes.split_last_chunk().ok_or(VerificationError::NoSeal)?;
        let (body, run) = rest.split_last_chunk().ok_or(VerificationError::NoSeal)?;
        let (run, signature) = (u64::from_le_bytes(*run), Signature::from_bytes(*signature));
        // The cheap check comes first.
        let message = own(&topic, body)?;
        if known_by.has_signed(&self.signed_bytes(run, key, body), signature) {
            Ok(Verified { message, run: Some(run) })
        } else {
            Err(VerificationError::NoSeal)
        }
    }

    /// Encodes a message, and signs it if there is a signing key.
    pub fn write(&self, signing_key: Option<&SigningKey>, run: u64, key: &str, message: &impl Message) -> Vec<u8> {
        let mut bytes = message::encode(message);
        if let Some(signing_key) = signing_key {
            let signature = signing_key.sign(&self.signed_bytes(run, key, &bytes));
            bytes.extend(run.to_le_bytes());
            bytes.extend(signature.to_bytes());
        }
        bytes
    }

    fn signed_bytes(&self, run: u64, key: &str, message: &[u8]) -> Vec<u8> {
        let mut bytes = super::signed_prefix(CONTEXT, &self.swarm, run);
        bytes.extend((key.len() as u64).to_le_bytes());
        bytes.extend(key.as_bytes());
        bytes.extend(message);
        bytes
    }
}

/// Decodes the message and checks that its sender may publish under this topic.
fn own<M: Message>(topic: &Topic, bytes: &[u8]) -> Result<M, VerificationError> {
    let message: M = message::decode(bytes)?;
    if message.is_allowed_under(topic) { Ok(message) } else { Err(VerificationError::OtherName) }
}

#[cfg(test)]
mod tests {
    use skein_common::id::{Incarnation, VehicleId};
    use skein_common::message::{Event, EventKind, Header, Order, Verb};
    use skein_common::time::SenderStamp;

    use super::super::tests::{name, signing_key};
    use super::*;

    fn id(number: u8) -> VehicleId {
        VehicleId::new(number).unwrap()
    }

    fn event(sender: u8) -> Event {
        let header = Header {
            sender: id(sender),
            incarnation: Incarnation(1),
            sequence: 5,
            stamp: SenderStamp::from_seconds(1.0),
        };
        Event { header, what: EventKind::Landed }
    }

    #[test]
    fn a_message_is_accepted_under_its_senders_key_with_its_senders_signature() {
        let (one, two) = (signing_key(), signing_key());
        let keys = BTreeMap::from([(id(1).into(), one.key()), (id(2).into(), two.key())]);
        let lab = KeyRing::signed(name("lab"), keys.clone());
        let bytes = lab.write(Some(&one), 7, "vehicle/1/event", &event(1));
        let read = |key_ring: &KeyRing, key: &str, bytes: &[u8]| key_ring.read::<Event>(key, bytes);
        assert_eq!(read(&lab, "vehicle/1/event", &bytes), Ok(Verified { message: event(1), run: Some(7) }));
        assert_eq!(bytes.len(), message::encode(&event(1)).len() + ADDED_BYTES);

        let forged = Err(VerificationError::NoSeal);
        assert_eq!(read(&lab, "vehicle/1/health", &bytes), forged, "another kind of message");
        assert_eq!(read(&KeyRing::signed(name("lab2"), keys), "vehicle/1/event", &bytes), forged, "another swarm");
        for by_two in [lab.write(Some(&two), 7, "vehicle/1/event", &event(1)), message::encode(&event(1))] {
            assert!(read(&lab, "vehicle/1/event", &by_two).is_err());
        }
        assert_eq!(read(&lab, "vehicle/2/event", &bytes), Err(VerificationError::OtherName));
        assert_eq!(read(&lab, "order/1", &bytes).unwrap_err().reason(), Reason::Undecodable);
        assert_eq!(read(&lab, "vehicle/3/event", &bytes), Err(VerificationError::UnknownVehicle));
        assert_eq!(read(&lab, "somewhere/else", &bytes), Err(VerificationError::OtherName));
    }

    #[test]
    fn a_signed_message_with_a_changed_or_missing_byte_is_refused() {
        let one = signing_key();
        let lab = KeyRing::signed(name("lab"), BTreeMap::from([(id(1).into(), one.key())]));
        let bytes = lab.write(Some(&one), 7, "vehicle/1/event", &event(1));
        for nth in 0..bytes.len() {
            for bit in 0..8 {
                let mut changed = bytes.clone();
                changed[nth] ^= 1 << bit;
                assert!(lab.read::<Event>("vehicle/1/event", &changed).is_err(), "bit {bit} of byte {nth}");
            }
            assert!(lab.read::<Event>("vehicle/1/event", &bytes[..nth]).is_err(), "{nth} bytes");
        }
    }

    #[test]
    fn plain_messages_and_orders_carry_no_vehicle_signature() {
        let plain = KeyRing::plain(name("lab"));
        let bytes = plain.write(None, 7, "vehicle/1/event", &event(1));
        assert_eq!(bytes, message::encode(&event(1)));
        assert_eq!(plain.read("vehicle/1/event", &bytes), Ok(Verified { message: event(1), run: None }));
        assert_eq!(plain.read::<Event>("vehicle/2/event", &bytes), Err(VerificationError::OtherName));
        let order = Order { epoch: 1, issuer: 9, verb: Verb::Land, vehicles: None, signature: None };
        for key_ring in [plain, KeyRing::signed(name("lab"), BTreeMap::new())] {
            assert_eq!(key_ring.read("order/9", &message::encode(&order)), Ok(Verified { message: order, run: None }));
            assert_eq!(key_ring.read::<Order>("order/8", &message::encode(&order)), Err(VerificationError::OtherName));
        }
    }

    /// The signed bytes are part of the protocol.
    #[test]
    fn the_signed_bytes_are_exactly_these() {
        let mut golden = b"skein word v1\0".to_vec();
        golden.extend([3, 0, 0, 0, 0, 0, 0, 0]);
        golden.extend(b"lab");
        golden.extend([7, 0, 0, 0, 0, 0, 0, 0, 15, 0, 0, 0, 0, 0, 0, 0]);
        golden.extend(b"vehicle/1/event");
        golden.extend([4, 1, 2]);
        assert_eq!(KeyRing::plain(name("lab")).signed_bytes(7, "vehicle/1/event", &[4, 1, 2]), golden);
    }
}
