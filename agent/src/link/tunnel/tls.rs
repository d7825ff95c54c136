//! Who is at the other end: TLS 1.3 with certificates of the swarm's authority and of no other, and a name that
//! counts; a vehicle's also has the key that it is known by.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use skein_common::id::VehicleId;
use tokio::net::TcpStream;
use tokio_rustls::rustls::client::Resumption;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::version::TLS13;
use tokio_rustls::rustls::{ClientConfig, CommonState, RootCertStore, ServerConfig};
use tokio_rustls::{TlsAcceptor, TlsConnector, TlsStream};
use x509_parser::certificate::X509Certificate;
use x509_parser::prelude::FromDer;

use crate::link::LinkError;
use crate::link::seal::SealKey;
use crate::link::security::Tls;
use skein_host::clock::utc_nanoseconds;

/// The other end of a link.
pub(in crate::link) struct Peer {
    /// The common name in its certificate.
    pub(super) name: String,
    /// Whose agent it is; `None` for observers and operators.
    pub(super) vehicle: Option<VehicleId>,
    /// How long its certificate lasts from now on.
    pub(super) lasts: Duration,
}

/// Both kinds of ends of links.
pub(in crate::link) struct Ends {
    acceptor: TlsAcceptor,
    connector: TlsConnector,
    /// By common name: the vehicles, each with the key that its certificate has to be for, and those who are none.
    names: BTreeMap<String, Option<(VehicleId, SealKey)>>,
}

impl Ends {
    /// With these keys, for those whose names count.
    ///
    /// # Errors
    /// If a file has no key or certificate, or one that does not belong to the other.
    pub(in crate::link) fn new(tls: &Tls) -> Result<Self, LinkError> {
        let fault = |path: &Path| {
            let path = path.to_owned();
            move |error: tokio_rustls::rustls::Error| LinkError::File {
                path,
                source: io::Error::new(io::ErrorKind::InvalidData, error),
            }
        };
        let mut roots = RootCertStore::empty();
        for authority in certificates(&tls.authority)? {
            roots.add(authority).map_err(fault(&tls.authority))?;
        }
        let (roots, own) = (Arc::new(roots), certificates(&tls.certificate)?);
        let key = || PrivateKeyDer::from_pem_slice(&read(&tls.key)?).map_err(|_| nothing(&tls.key, "PRIVATE KEY"));
        let provider = Arc::new(ring::default_provider());
        let verifier = WebPkiClientVerifier::builder_with_provider(roots.clone(), provider.clone()).build();
        let verifier =
            verifier.map_err(|error| fault(&tls.authority)(tokio_rustls::rustls::Error::General(error.to_string())))?;
        let mut server = ServerConfig::builder_with_provider(provider.clone())
            .with_protocol_versions(&[&TLS13])
            .map_err(fault(&tls.authority))?
            .with_client_cert_verifier(verifier)
            .with_single_cert(own.clone(), key()?)
            .map_err(fault(&tls.key))?;
        let mut client = ClientConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&TLS13])
            .map_err(fault(&tls.authority))?
            .with_root_certificates(roots)
            .with_client_auth_cert(own, key()?)
            .map_err(fault(&tls.key))?;
        // Every link shows its certificates anew: one may have ended meanwhile.
        server.send_tls13_tickets = 0;
        client.resumption = Resumption::disabled();
        let vehicles = tls.vehicles.iter().map(|(id, known)| (known.name.clone(), Some((*id, known.key))));
        let guests = [&tls.observer, &tls.operator].map(|name| (name.clone(), None));
        Ok(Self {
            acceptor: Arc::new(server).into(),
            connector: Arc::new(client).into(),
            names: vehicles.chain(guests).collect(),
        })
    }

    /// Who has dialled.
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidData`] for somebody who is not let in; any other if the network fails.
    pub(super) async fn accept(&self, socket: TcpStream) -> io::Result<(TlsStream<TcpStream>, Peer)> {
        let stream = self.acceptor.accept(socket).await?;
        let peer = self.peer(stream.get_ref().1)?;
        Ok((stream.into(), peer))
    }

    /// Who was dialled as this host.
    ///
    /// # Errors
    /// As [`Self::accept`].
    pub(super) async fn connect(&self, host: &str, socket: TcpStream) -> io::Result<(TlsStream<TcpStream>, Peer)> {
        let name = ServerName::try_from(host.to_owned()).map_err(refused)?;
        let stream = self.connector.connect(name, socket).await?;
        let peer = self.peer(stream.get_ref().1)?;
        if peer.vehicle.is_none() {
            return Err(refused(format!("{} is no vehicle", peer.name)));
        }
        Ok((stream.into(), peer))
    }

    fn peer(&self, connection: &CommonState) -> io::Result<Peer> {
        let shown = connection.peer_certificates().and_then(<[_]>::first).ok_or_else(|| refused("no certificate"))?;
        let (_, shown) = X509Certificate::from_der(shown).map_err(refused)?;
        let name = shown.subject().iter_common_name().next().and_then(|name| name.as_str().ok());
        let name = name.ok_or_else(|| refused("a certificate without a name"))?;
        let known = self.names.get(name);
        let known = known.ok_or_else(|| refused(format!("the certificate {name:?} does not count here")))?;
        // One whose key was lost and made anew has the same name.
        if known.is_some_and(|(_, key)| *shown.public_key().subject_public_key.data != key.to_bytes()) {
            return Err(refused(format!("the certificate {name:?} is for a key that does not count here")));
        }
        let ends_s = u64::try_from(shown.validity().not_after.timestamp()).unwrap_or(0);
        // UTC, for that is what certificates end by.
        let now = Duration::from_nanos(utc_nanoseconds());
        Ok(Peer::new(name.to_owned(), known.map(|(id, _)| id), Duration::from_secs(ends_s).saturating_sub(now)))
    }
}

fn refused(why: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

fn read(path: &Path) -> Result<Vec<u8>, LinkError> {
    fs::read(path).map_err(|source| LinkError::File { path: path.to_owned(), source })
}

fn nothing(path: &Path, what: &str) -> LinkError {
    LinkError::File { path: path.to_owned(), source: refused(format!("no {what} in it")) }
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, LinkError> {
    let text = read(path)?;
    let all: Vec<_> = CertificateDer::pem_slice_iter(&text).filter_map(Result::ok).collect();
    if all.is_empty() { Err(nothing(path, "CERTIFICATE")) } else { Ok(all) }
}
