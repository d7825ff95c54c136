//! Identifies the other end of a link: TLS 1.3 with a certificate of the swarm's authority, of no other, and with a
//! known common name. A vehicle's certificate must also be for the key that the swarm has for that vehicle.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;

use rustls_pki_types::pem::PemObject;
use rustls_pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use skein_common::id::VehicleName;
use tokio::net::TcpStream;
use tokio_rustls::rustls::client::Resumption;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::server::WebPkiClientVerifier;
use tokio_rustls::rustls::version::TLS13;
use tokio_rustls::rustls::{ClientConfig, CommonState, RootCertStore, ServerConfig};
use tokio_rustls::{TlsAcceptor, TlsConnector};

use super::Connection;
use crate::link::LinkError;
use crate::link::security::{Certified, Tls, certified};
use crate::link::signature::VerificationKey;

/// The identified other end of a link.
pub(in crate::link) struct Peer {
    /// Common name in its certificate.
    pub(super) name: String,
    /// Vehicle of the agent; `None` for observers and operators.
    pub(super) vehicle: Option<VehicleName>,
}

/// TLS configuration for accepting and for making links.
pub(in crate::link) struct TlsContext {
    acceptor: TlsAcceptor,
    connector: TlsConnector,
    /// Known common names: a vehicle's with its name and key, an observer's or operator's with `None`.
    names: BTreeMap<String, Option<(VehicleName, VerificationKey)>>,
}

impl TlsContext {
    /// Reads the keys and certificates, and takes over the known names.
    ///
    /// # Errors
    /// If a file has no key or certificate, or the two do not belong together.
    pub(in crate::link) fn new(tls: &Tls) -> Result<Self, LinkError> {
        let fault = |path: &Path| {
            let path = path.to_owned();
            move |error: tokio_rustls::rustls::Error| LinkError::File(path, refused(error))
        };
        let mut roots = RootCertStore::empty();
        for authority in certificates(&tls.authority)? {
            roots.add(authority).map_err(fault(&tls.authority))?;
        }
        let (roots, own) = (Arc::new(roots), certificates(&tls.certificate)?);
        let key = || PrivateKeyDer::from_pem_slice(&read(&tls.key)?).map_err(|_| missing(&tls.key, "PRIVATE KEY"));
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
        // Every link checks the certificates again, because one may have expired meanwhile.
        server.send_tls13_tickets = 0;
        client.resumption = Resumption::disabled();
        let vehicles = tls.vehicles.iter().map(|(id, known)| (known.name.clone(), Some((*id, known.key))));
        let guests = tls.guests().map(|name| (name.clone(), None));
        Ok(Self {
            acceptor: Arc::new(server).into(),
            connector: Arc::new(client).into(),
            names: vehicles.chain(guests).collect(),
        })
    }

    /// Completes the handshake with a host that has dialled this one.
    ///
    /// # Errors
    /// [`io::ErrorKind::InvalidData`] if the host is refused; any other kind if the network fails.
    pub(super) async fn accept(&self, socket: TcpStream) -> io::Result<Connection> {
        let stream = self.acceptor.accept(socket).await?;
        let peer = self.peer(stream.get_ref().1)?;
        Ok(Connection { stream: Box::new(stream), peer: Some(peer) })
    }

    /// Completes the handshake with a host that this one has dialled.
    ///
    /// # Errors
    /// The same as [`Self::accept`].
    pub(super) async fn connect(&self, host: &str, socket: TcpStream) -> io::Result<Connection> {
        let name = ServerName::try_from(host.to_owned()).map_err(refused)?;
        let stream = self.connector.connect(name, socket).await?;
        let peer = self.peer(stream.get_ref().1)?;
        if peer.vehicle.is_none() {
            return Err(refused(format!("the certificate {:?} does not belong to a vehicle", peer.name)));
        }
        Ok(Connection { stream: Box::new(stream), peer: Some(peer) })
    }

    fn peer(&self, connection: &CommonState) -> io::Result<Peer> {
        let certificates = connection.peer_certificates();
        self.identify(certificates.and_then(<[_]>::first).ok_or_else(|| refused("no certificate"))?)
    }

    /// Identifies the owner of a certificate (DER) that the swarm's authority has signed.
    fn identify(&self, certificate: &[u8]) -> io::Result<Peer> {
        let Certified { name, key: certified } = certified(certificate).map_err(refused)?;
        let known = self.names.get(&name);
        let known = known.ok_or_else(|| refused(format!("the certificate name {name:?} is not known here")))?;
        // A replacement for a lost key has the same name.
        if known.is_some_and(|(_, key)| *certified != key.0) {
            return Err(refused(format!("the certificate {name:?} is for a key that is not known here")));
        }
        Ok(Peer { vehicle: known.map(|(id, _)| id), name })
    }
}

fn refused(why: impl Into<Box<dyn std::error::Error + Send + Sync>>) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidData, why)
}

fn read(path: &Path) -> Result<Vec<u8>, LinkError> {
    fs::read(path).map_err(|source| LinkError::File(path.to_owned(), source))
}

fn missing(path: &Path, what: &str) -> LinkError {
    LinkError::File(path.to_owned(), refused(format!("no {what} in it")))
}

fn certificates(path: &Path) -> Result<Vec<CertificateDer<'static>>, LinkError> {
    let text = read(path)?;
    let all: Vec<_> = CertificateDer::pem_slice_iter(&text).filter_map(Result::ok).collect();
    if all.is_empty() { Err(missing(path, "CERTIFICATE")) } else { Ok(all) }
}

#[cfg(test)]
mod tests;
