//! Signatures (Ed25519, RFC 8032) that prove the sender of a message: an operator signs orders ([`orders`]), a vehicle
//! signs its other messages ([`messages`]). A signature is valid in one run of one swarm only, so a message replayed from
//! an earlier run or another swarm is refused.

pub mod messages;
pub mod orders;
pub mod runs;

use std::fmt;
use std::str::FromStr;

use ring::signature::{ED25519, Ed25519KeyPair, KeyPair, UnparsedPublicKey};
use rustls_pki_types::PrivatePkcs8KeyDer;
use rustls_pki_types::pem::PemObject;
use serde::{Deserialize, Serialize};
use skein_common::id::SwarmName;
use skein_common::message::Signature;

/// The reason why a text or bytes are not a key.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum NotAKey {
    /// Not a private key.
    #[error("not an Ed25519 key in PKCS#8")]
    Private,
    /// Not a public key.
    #[error("a public key must have 64 hexadecimal digits")]
    Public,
}

/// Public key that verifies one sender's signatures. As text it has 64 hexadecimal digits.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct VerificationKey(pub [u8; 32]);

impl VerificationKey {
    /// Whether `signature` is the signature of these bytes with the matching private key. Takes about 100 µs.
    fn has_signed(&self, bytes: &[u8], signature: Signature) -> bool {
        UnparsedPublicKey::new(&ED25519, self.0).verify(bytes, &signature.to_bytes()).is_ok()
    }
}

impl FromStr for VerificationKey {
    type Err = NotAKey;
    fn from_str(text: &str) -> Result<Self, NotAKey> {
        from_hex(text).map(Self).ok_or(NotAKey::Public)
    }
}

impl TryFrom<String> for VerificationKey {
    type Error = NotAKey;
    fn try_from(text: String) -> Result<Self, NotAKey> {
        text.parse()
    }
}

impl From<VerificationKey> for String {
    fn from(key: VerificationKey) -> Self {
        key.to_string()
    }
}

impl fmt::Display for VerificationKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for VerificationKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "VerificationKey({self})")
    }
}

/// Private key that signs messages.
pub struct SigningKey(Ed25519KeyPair);

impl SigningKey {
    /// Reads the key from a PKCS#8 document (DER), with or without its public key.
    ///
    /// # Errors
    /// If the document is not such a key.
    pub fn from_pkcs8(der: &[u8]) -> Result<Self, NotAKey> {
        Ed25519KeyPair::from_pkcs8_maybe_unchecked(der).map(Self).map_err(|_| NotAKey::Private)
    }

    /// Reads the key from a PKCS#8 document in PEM.
    ///
    /// # Errors
    /// The same as [`Self::from_pkcs8`].
    pub fn from_pem(text: &str) -> Result<Self, NotAKey> {
        let der = PrivatePkcs8KeyDer::from_pem_slice(text.as_bytes()).map_err(|_| NotAKey::Private)?;
        Self::from_pkcs8(der.secret_pkcs8_der())
    }

    /// The public key that verifies this key's signatures.
    pub fn key(&self) -> VerificationKey {
        let mut key = [0; 32];
        key.copy_from_slice(self.0.public_key().as_ref());
        VerificationKey(key)
    }

    fn sign(&self, bytes: &[u8]) -> Signature {
        let mut signature = [0; Signature::BYTES];
        signature.copy_from_slice(self.0.sign(bytes).as_ref());
        Signature::from_bytes(signature)
    }
}

impl fmt::Debug for SigningKey {
    /// Shows the public key only.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "SigningKey(of {:?})", self.key())
    }
}

/// The bytes of a text with two hexadecimal digits for each.
fn from_hex<const N: usize>(text: &str) -> Option<[u8; N]> {
    let digit = |digit: u8| char::from(digit).to_digit(16);
    let (pairs, []) = text.as_bytes().as_chunks::<2>() else { return None };
    let bytes = pairs.iter().map(|&[high, low]| Some((16 * digit(high)? + digit(low)?) as u8));
    bytes.collect::<Option<Vec<u8>>>()?.try_into().ok()
}

/// Start of the signed bytes: purpose, swarm and run. The length of the swarm's name precedes it, so that no two signed
/// messages have the same bytes. Nothing else that these keys sign starts like one of our contexts (TLS 1.3 starts with
/// 64 spaces, RFC 8446, 4.4.3).
fn signed_prefix(context: &[u8], swarm: &SwarmName, run: u64) -> Vec<u8> {
    let name = swarm.as_str().as_bytes();
    let mut bytes = context.to_vec();
    bytes.extend((name.len() as u64).to_le_bytes());
    bytes.extend(name);
    bytes.extend(run.to_le_bytes());
    bytes
}

#[cfg(test)]
pub(crate) mod tests {
    use ring::rand::SystemRandom;

    use super::*;

    pub(crate) fn signing_key() -> SigningKey {
        SigningKey::from_pkcs8(Ed25519KeyPair::generate_pkcs8(&SystemRandom::new()).unwrap().as_ref()).unwrap()
    }

    pub(crate) fn name(text: &str) -> SwarmName {
        SwarmName::new(text).unwrap()
    }

    /// RFC 8032, 7.1, test 3.
    #[test]
    fn signatures_are_ed25519() {
        let hex = |text: &str| -> Vec<u8> {
            text.as_bytes().chunks(2).map(|two| u8::from_str_radix(str::from_utf8(two).unwrap(), 16).unwrap()).collect()
        };
        let seed = hex("c5aa8df43f9f837bedb7442f31dcb7b166d38535076f094b85ce3a2e0b4458f7");
        let public = "fc51cd8e6218a1a38da47ed00230f0580816ed13ba3303ac5deb911548908025";
        // PKCS#8 version 1 as OpenSSL writes it: a fixed header and the seed.
        let der = [hex("302e020100300506032b657004220420"), seed].concat();
        let signing_key = SigningKey::from_pkcs8(&der).unwrap();
        assert_eq!(Ok(signing_key.key()), public.parse());
        assert_eq!(
            format!("{signing_key:?}"),
            format!("SigningKey(of VerificationKey({public}))"),
            "the secret is not shown"
        );
        assert!(SigningKey::from_pkcs8(b"key").is_err() && SigningKey::from_pem("key").is_err());
        let expected = "6291d657deec24024827e69c3abe01a30ce548a284743a445e3680d7db5ac3ac18ff9b538d16f290ae67f760984dc6594a7c15e9716ed28dc027beceea1ec40a";
        let signature = signing_key.sign(&[0xaf, 0x82]);
        assert_eq!(signature.to_bytes().as_slice(), hex(expected));
        assert!(
            signing_key.key().has_signed(&[0xaf, 0x82], signature)
                && !signing_key.key().has_signed(&[0xaf, 0x83], signature)
        );
    }

    #[test]
    fn a_key_survives_writing_and_reading() {
        let key = signing_key().key();
        assert_eq!(key.to_string().parse(), Ok(key));
        for text in ["", "0", &"0".repeat(63), &"0".repeat(65), &"g".repeat(64), &"é".repeat(32)] {
            assert_eq!(text.parse::<VerificationKey>(), Err(NotAKey::Public), "{text:?}");
        }
    }
}
