//! Issues a certificate, and checks whether an existing one is still valid and as required.

use std::net::IpAddr;

use crate::keys::Role;
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, ExtendedKeyUsagePurpose, IsCa, Issuer, KeyPair,
    KeyUsagePurpose, PublicKeyData,
};
use skein_agent::link::security::PeerIdentity;
use skein_agent::link::signature::VerificationKey;
use time::{Duration, OffsetDateTime};
use x509_parser::certificate::X509Certificate;
use x509_parser::extensions::GeneralName;
use x509_parser::pem::Pem;

/// Validity of a certificate.
const VALID: Duration = Duration::days(365);
/// Validity of the authority's certificate.
const AUTHORITY_VALID: Duration = Duration::days(3650);
/// Remaining validity below which a certificate is issued again.
const RENEW_BEFORE: Duration = Duration::days(30);
/// Remaining validity below which no flight begins. A link outlives its certificates, but a vehicle that is restarted in
/// flight needs a new link.
pub(crate) const FLIGHT: Duration = Duration::hours(24);
/// Time by which the start of a certificate's validity is backdated: a node whose clock is behind could not connect until then. The
/// clock of a PC without a battery may be days behind.
const BACKDATED: Duration = Duration::days(7);

/// A certificate and its private key, PEM.
#[derive(Clone)]
pub(crate) struct Pair {
    pub(crate) certificate: String,
    pub(crate) key: String,
}

/// The required contents of a certificate.
#[derive(Clone, Debug)]
pub(crate) struct CertificateSpec<'a> {
    pub(crate) role: Role,
    /// Common name.
    pub(crate) name: &'a str,
    /// Address at which a vehicle's agent is dialled.
    pub(crate) address: Option<&'a str>,
}

/// The authority that signs the swarm's certificates.
pub(crate) struct Authority {
    issuer: Issuer<'static, KeyPair>,
    /// Its own certificate, PEM.
    pub(crate) certificate: String,
}

/// The reason why a certificate is invalid or has to be replaced soon.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub(crate) enum Unfit {
    /// The certificate or its key cannot be read.
    #[error("unreadable")]
    Unreadable,
    /// It is signed by another authority.
    #[error("signed by another authority")]
    OtherAuthority,
    /// It does not belong to its key.
    #[error("does not belong to its key")]
    OtherKey,
    /// It has another common name, or its name was revoked.
    #[error("has another name")]
    OtherName,
    /// Its node has another address now.
    #[error("has another address")]
    OtherAddress,
    /// It has expired.
    #[error("has expired")]
    Expired,
    /// It expires within a day, and is valid until then.
    #[error("expires within 24 h")]
    ExpiringToday,
    /// It expires soon, and is valid until then.
    #[error("expires soon")]
    Expiring,
}

impl Unfit {
    /// Whether peers reject the certificate.
    pub(crate) fn is_fatal(&self) -> bool {
        !matches!(self, Self::Expiring | Self::ExpiringToday)
    }
}

impl Authority {
    /// Creates an authority with a new key.
    pub(crate) fn new(swarm: &str, now: OffsetDateTime) -> Result<(Self, Pair), rcgen::Error> {
        Self::renewed(swarm, &KeyPair::generate()?.serialize_pem(), now)
    }

    /// Issues the authority's certificate again with a new end of validity. Certificates that it has signed stay valid,
    /// because the key is the same.
    pub(crate) fn renewed(swarm: &str, key: &str, now: OffsetDateTime) -> Result<(Self, Pair), rcgen::Error> {
        let mut params = CertificateParams::new(Vec::new())?;
        params.distinguished_name = DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, Self::name(swarm));
        params.is_ca = IsCa::Ca(BasicConstraints::Constrained(0));
        params.key_usages = vec![KeyUsagePurpose::KeyCertSign];
        (params.not_before, params.not_after) = (now - BACKDATED, now + AUTHORITY_VALID);
        let certificate = params.self_signed(&KeyPair::from_pem(key)?)?.pem();
        let pair = Pair { certificate, key: key.to_owned() };
        Ok((Self::read(&pair)?, pair))
    }

    /// Common name of the authority of this swarm.
    pub(crate) fn name(swarm: &str) -> String {
        format!("authority of {swarm}")
    }

    /// Returns why the authority cannot sign or would be rejected, if so.
    pub(crate) fn unfit(pair: &Pair, now: OffsetDateTime) -> Option<Unfit> {
        let own = pem(&pair.certificate);
        let own = own.as_ref().and_then(|own| own.parse_x509().ok());
        let Some((own, key)) = own.zip(KeyPair::from_pem(&pair.key).ok()) else { return Some(Unfit::Unreadable) };
        if own.public_key().subject_public_key.data.as_ref() != key.der_bytes() {
            return Some(Unfit::OtherKey);
        }
        ends(&own, now)
    }

    /// Reads the authority from its certificate and key.
    pub(crate) fn read(pair: &Pair) -> Result<Self, rcgen::Error> {
        let issuer = Issuer::from_ca_cert_pem(&pair.certificate, KeyPair::from_pem(&pair.key)?)?;
        Ok(Self { issuer, certificate: pair.certificate.clone() })
    }

    /// Issues a certificate for this private key, PEM.
    pub(crate) fn issue(
        &self,
        spec: &CertificateSpec<'_>,
        key: &str,
        now: OffsetDateTime,
    ) -> Result<String, rcgen::Error> {
        let key = KeyPair::from_pem(key)?;
        let mut params = CertificateParams::new(spec.address.map(str::to_owned).into_iter().collect::<Vec<_>>())?;
        params.distinguished_name = DistinguishedName::new();
        params.distinguished_name.push(DnType::CommonName, spec.name);
        params.key_usages = vec![KeyUsagePurpose::DigitalSignature];
        params.extended_key_usages = vec![ExtendedKeyUsagePurpose::ClientAuth];
        if matches!(spec.role, Role::Vehicle(_)) {
            // Agents also accept connections.
            params.extended_key_usages.push(ExtendedKeyUsagePurpose::ServerAuth);
        }
        params.use_authority_key_identifier_extension = true;
        (params.not_before, params.not_after) = (now - BACKDATED, now + VALID);
        Ok(params.signed_by(&key, &self.issuer)?.pem())
    }
}

/// Returns the end of a certificate's validity.
pub(crate) fn expires(certificate: &str) -> Option<OffsetDateTime> {
    let pem = pem(certificate)?;
    Some(pem.parse_x509().ok()?.validity().not_after.to_datetime())
}

/// Returns the common name and the public key in a certificate.
pub(crate) fn shows(certificate: &str) -> Option<PeerIdentity> {
    let pem = pem(certificate)?;
    let shown = pem.parse_x509().ok()?;
    let key: [u8; 32] = shown.public_key().subject_public_key.data.as_ref().try_into().ok()?;
    Some(PeerIdentity { name: common_name(&shown)?.to_owned(), key: VerificationKey(key) })
}

/// Returns why this certificate is invalid or has to be replaced soon, if so: it must be signed by this authority,
/// belong to its key and meet the requirements.
pub(crate) fn unfit(pair: &Pair, spec: &CertificateSpec<'_>, authority: &str, now: OffsetDateTime) -> Option<Unfit> {
    let (own, authority) = (pem(&pair.certificate), pem(authority));
    let (own, authority) = (own.as_ref(), authority.as_ref());
    let parsed = own.and_then(|own| own.parse_x509().ok()).zip(authority.and_then(|its| its.parse_x509().ok()));
    let Some(((own, authority), key)) = parsed.zip(KeyPair::from_pem(&pair.key).ok()) else {
        return Some(Unfit::Unreadable);
    };
    let faults = [
        (own.verify_signature(Some(authority.public_key())).is_err(), Unfit::OtherAuthority),
        (own.public_key().subject_public_key.data.as_ref() != key.der_bytes(), Unfit::OtherKey),
        (common_name(&own) != Some(spec.name), Unfit::OtherName),
        (!spec.address.is_none_or(|address| is_for(&own, address)), Unfit::OtherAddress),
    ];
    faults.into_iter().find(|(is_so, _)| *is_so).map(|(_, fault)| fault).or_else(|| ends(&own, now))
}

fn ends(certificate: &X509Certificate<'_>, now: OffsetDateTime) -> Option<Unfit> {
    match certificate.validity().not_after.to_datetime() {
        end if end < now => Some(Unfit::Expired),
        end if end < now + FLIGHT => Some(Unfit::ExpiringToday),
        end if end < now + RENEW_BEFORE => Some(Unfit::Expiring),
        _ => None,
    }
}

fn pem(text: &str) -> Option<Pem> {
    Pem::iter_from_buffer(text.as_bytes()).next()?.ok()
}

fn common_name<'c>(certificate: &'c X509Certificate<'_>) -> Option<&'c str> {
    certificate.subject().iter_common_name().next()?.as_str().ok()
}

/// Whether a peer that dials this address accepts the certificate.
fn is_for(certificate: &X509Certificate<'_>, address: &str) -> bool {
    let Ok(Some(names)) = certificate.subject_alternative_name() else { return false };
    let octets = address.parse::<IpAddr>().ok().map(|ip| match ip {
        IpAddr::V4(ip) => ip.octets().to_vec(),
        IpAddr::V6(ip) => ip.octets().to_vec(),
    });
    names.value.general_names.iter().any(|name| match (name, &octets) {
        (GeneralName::IPAddress(bytes), Some(octets)) => bytes == octets,
        (GeneralName::DNSName(name), None) => *name == address,
        _ => false,
    })
}
