//! The operator's signed note of a run of the swarm, which proves that the operator began that run.

use serde::{Deserialize, Serialize};
use skein_common::id::SwarmName;
use skein_common::message::Signature;

use super::{SigningKey, VerificationKey};

/// Marks a signed note; nothing else signed with an orders key starts like this.
const CONTEXT: &[u8] = b"skein run v1\0";

/// A run of the swarm and its begin, signed with the operator's orders key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunNote {
    /// The run's number.
    pub run: u64,
    /// Begin of the run by the operator's clock, ms since 1970; later than every earlier run that the operator knew of.
    pub began_ms: u64,
    #[serde(rename = "seal", with = "hex")]
    signature: Signature,
}

impl RunNote {
    /// Signs a note of a run that begins now.
    pub fn new(signing_key: &SigningKey, swarm: &SwarmName, run: u64, began_ms: u64) -> Self {
        Self { run, began_ms, signature: signing_key.sign(&signed_bytes(swarm, run, began_ms)) }
    }

    /// Whether the operator of this swarm, with this public key, signed this note.
    pub fn is_signed(&self, key: &VerificationKey, swarm: &SwarmName) -> bool {
        key.has_signed(&signed_bytes(swarm, self.run, self.began_ms), self.signature)
    }
}

fn signed_bytes(swarm: &SwarmName, run: u64, began_ms: u64) -> Vec<u8> {
    let mut bytes = super::signed_prefix(CONTEXT, swarm, run);
    bytes.extend(began_ms.to_le_bytes());
    bytes
}

/// Writes and reads a signature as 128 hexadecimal digits.
mod hex {
    use serde::de::Error;
    use serde::{Deserialize, Deserializer, Serializer};
    use skein_common::message::Signature;

    pub(super) fn serialize<S: Serializer>(signature: &Signature, to: S) -> Result<S::Ok, S::Error> {
        to.collect_str(&signature.to_bytes().iter().map(|byte| format!("{byte:02x}")).collect::<String>())
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Signature, D::Error> {
        let text = String::deserialize(from)?;
        let bytes = super::super::from_hex(&text).map(Signature::from_bytes);
        bytes.ok_or_else(|| D::Error::custom("a signature has 128 hexadecimal digits"))
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{name, signing_key};
    use super::*;

    #[test]
    fn a_run_note_is_valid_for_one_run_of_one_swarm() {
        let (operator, lab) = (signing_key(), name("lab"));
        let (key, note) = (operator.key(), RunNote::new(&operator, &lab, 7, 1000));
        assert!(note.is_signed(&key, &lab));
        assert!(!note.is_signed(&key, &name("lab2")), "in another swarm");
        assert!(!note.is_signed(&signing_key().key(), &lab), "signed by another operator");
        for other in [RunNote { run: 8, ..note }, RunNote { began_ms: 1001, ..note }] {
            assert!(!other.is_signed(&key, &lab), "{other:?}");
        }
    }

    #[test]
    fn a_run_note_survives_writing_and_reading() {
        let note = RunNote::new(&signing_key(), &name("lab"), 7, 1000);
        let written = format!("{{\"run\":7,\"began_ms\":1000,\"seal\":\"{}\"}}", "0f".repeat(Signature::BYTES));
        let read: RunNote = serde_json::from_str(&written).unwrap();
        assert_eq!(serde_json::to_string(&read).unwrap(), written);
        let again: RunNote = serde_json::from_str(&serde_json::to_string(&note).unwrap()).unwrap();
        assert_eq!(again, note);
        for bad in ["", "0", &"0f".repeat(63), &"0f".repeat(65), &"0g".repeat(64), &"é".repeat(64)] {
            let text = format!("{{\"run\":7,\"began_ms\":1000,\"seal\":\"{bad}\"}}");
            assert!(serde_json::from_str::<RunNote>(&text).is_err(), "{bad:?}");
        }
    }
}
