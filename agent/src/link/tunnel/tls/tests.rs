use proptest::collection::vec;
use proptest::prelude::*;
use proptest::sample::Index;
use rcgen::{
    BasicConstraints, CertificateParams, DistinguishedName, DnType, DnValue, IsCa, Issuer, KeyPair, PKCS_ED25519,
};
use skein_common::id::VehicleId;

use super::*;
use crate::link::security::PeerIdentity;

/// The authority, and the context of vehicle 1. The swarm knows vehicle 2 by `vehicle-2` and its key.
struct Swarm {
    issuer: Issuer<'static, KeyPair>,
    of_second: KeyPair,
    context: TlsContext,
}

impl Swarm {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let key = KeyPair::generate().unwrap();
        let mut about = CertificateParams::default();
        about.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        let own = about.self_signed(&key).unwrap();
        let issuer = Issuer::new(about, key);
        let [of_first, of_second] = [(); 2].map(|()| KeyPair::generate_for(&PKCS_ED25519).unwrap());
        let file = |name: &str, text: &str| {
            let path = folder.path().join(name);
            fs::write(&path, text).unwrap();
            path
        };
        let public_key = of_second.public_key_raw().first_chunk::<32>().copied().unwrap();
        let second = PeerIdentity { name: "vehicle-2".to_owned(), key: VerificationKey(public_key) };
        let tls = Tls {
            authority: file("authority.pem", &own.pem()),
            certificate: file("own.pem", &signed(&issuer, &of_first, name(&["vehicle-1"])).1),
            key: file("own.key", &of_first.serialize_pem()),
            orders: VerificationKey(public_key),
            vehicles: BTreeMap::from([(VehicleName::from(VehicleId::new(2).unwrap()), second)]),
            observers: vec!["observer".to_owned()],
            operator: "operator".to_owned(),
        };
        Self { context: TlsContext::new(&tls).unwrap(), issuer, of_second }
    }

    /// The name and vehicle that this swarm sees in such a certificate.
    fn identify(&self, key: &KeyPair, name: DistinguishedName) -> Result<(String, Option<VehicleName>), String> {
        let peer = self.context.identify(&signed(&self.issuer, key, name).0);
        peer.map(|peer| (peer.name, peer.vehicle)).map_err(|error| error.to_string())
    }
}

/// A certificate with this name for this key, as DER and as PEM.
fn signed(issuer: &Issuer<'static, KeyPair>, key: &KeyPair, name: DistinguishedName) -> (Vec<u8>, String) {
    let mut about = CertificateParams::new(["127.0.0.1".to_owned(), "vehicle-2".to_owned()]).unwrap();
    about.distinguished_name = name;
    let certificate = about.signed_by(key, issuer).unwrap();
    (certificate.der().to_vec(), certificate.pem())
}

fn name(common_names: &[&str]) -> DistinguishedName {
    let mut name = DistinguishedName::new();
    common_names.iter().for_each(|one| name.push(DnType::CommonName, *one));
    name
}

#[test]
fn only_the_exact_name_with_its_key_is_a_vehicle() {
    let swarm = Swarm::new();
    let second = swarm.identify(&swarm.of_second, name(&["vehicle-2"])).unwrap();
    assert_eq!(second, ("vehicle-2".to_owned(), Some(VehicleId::new(2).unwrap().into())));
    assert_eq!(swarm.identify(&swarm.of_second, name(&["observer"])).unwrap().1, None);
    let long = "v".repeat(10_000);
    for unknown in [
        "",
        " vehicle-2",
        "vehicle-2 ",
        "vehicle-2\0",
        "vehicle-2\0.evil",
        "VEHICLE-2",
        "vehicle-2.2",
        "vehicle-2,CN=vehicle-2",
        &long,
    ] {
        let why = swarm.identify(&swarm.of_second, name(&[unknown])).unwrap_err();
        assert!(why.contains("is not known here"), "{why}");
    }
    // `vehicle-2` is an address in this certificate. Only a common name counts.
    let why = swarm.identify(&swarm.of_second, DistinguishedName::new()).unwrap_err();
    assert_eq!(why, "a certificate without a common name");
    let utf16 = DnValue::BmpString("vehicle-2".try_into().unwrap());
    let mut in_utf16 = DistinguishedName::new();
    in_utf16.push(DnType::CommonName, utf16);
    assert!(swarm.identify(&swarm.of_second, in_utf16).is_err());
    // Keys that are not the vehicle's, one of them of another kind.
    for key in [KeyPair::generate_for(&PKCS_ED25519).unwrap(), KeyPair::generate().unwrap()] {
        let why = swarm.identify(&key, name(&["vehicle-2"])).unwrap_err();
        assert!(why.contains("is for a key that is not known here"), "{why}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 4_000, failure_persistence: None, ..ProptestConfig::default() })]
    #[test]
    fn a_damaged_certificate_is_refused_or_has_a_known_name_and_key(
        edits in vec((any::<Index>(), any::<u8>()), 0..6),
        cut in proptest::option::of(any::<Index>()),
    ) {
        thread_local!(static SWARM: Swarm = Swarm::new());
        SWARM.with(|swarm| {
            let (mut certificate, _) = signed(&swarm.issuer, &swarm.of_second, name(&["vehicle-2"]));
            edits.iter().for_each(|(at, byte)| *at.get_mut(&mut certificate) = *byte);
            certificate.truncate(cut.map_or(certificate.len(), |cut| cut.index(certificate.len())));
            if let Ok(peer) = swarm.context.identify(&certificate) {
                let public_key = swarm.of_second.public_key_raw();
                let has_key = certificate.windows(public_key.len()).any(|window| window == public_key);
                let is_second = peer.vehicle.is_some() && peer.name == "vehicle-2" && has_key;
                assert!(is_second || peer.vehicle.is_none() && ["observer", "operator"].contains(&&*peer.name));
            }
        });
    }
}
