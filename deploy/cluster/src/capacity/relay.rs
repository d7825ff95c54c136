//! A relay that counts the bytes of one TCP connection in each direction.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;

/// Payload bytes that have passed in each direction.
#[derive(Debug, Default)]
pub(super) struct Counts {
    /// From the listening end to the dialling end.
    pub(super) to_dialler: AtomicU64,
    /// From the dialling end to the listening end.
    pub(super) to_listener: AtomicU64,
}

/// Opens a relay to `listener`; returns the address to dial instead and the byte counts. It carries one connection and
/// ends with it.
pub(super) fn open(listener: SocketAddr) -> io::Result<(SocketAddr, Arc<Counts>)> {
    let front = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let address = front.local_addr()?;
    let counts = Arc::new(Counts::default());
    let counted = counts.clone();
    thread::spawn(move || -> io::Result<()> {
        let (dialler, _) = front.accept()?;
        let listener = TcpStream::connect(listener)?;
        dialler.set_nodelay(true)?;
        listener.set_nodelay(true)?;
        let (there, back) = (counted.clone(), counted);
        let (from, to) = (dialler.try_clone()?, listener.try_clone()?);
        thread::spawn(move || carry(from, to, &there.to_listener));
        carry(listener, dialler, &back.to_dialler);
        Ok(())
    });
    Ok((address, counts))
}

/// Copies bytes in one direction and counts them, until either end closes.
fn carry(mut from: TcpStream, mut to: TcpStream, count: &AtomicU64) {
    let mut buffer = [0; 65_536];
    while let Ok(size) = from.read(&mut buffer) {
        // Count first, so that a received byte is always counted.
        count.fetch_add(size as u64, Relaxed);
        if size == 0 || to.write_all(&buffer[..size]).is_err() {
            break;
        }
    }
    // The other end may be closed already.
    let _ = to.shutdown(Shutdown::Both);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bytes_are_counted_in_each_direction() {
        let end = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let (address, counts) = open(end.local_addr().unwrap()).unwrap();
        let mut dialler = TcpStream::connect(address).unwrap();
        let (mut listener, _) = end.accept().unwrap();
        let mut received = [0; 5];
        dialler.write_all(b"hello").unwrap();
        listener.read_exact(&mut received).unwrap();
        assert_eq!(&received, b"hello");
        listener.write_all(b"yes").unwrap();
        dialler.read_exact(&mut received[..3]).unwrap();
        drop(listener);
        assert_eq!(dialler.read(&mut received).unwrap(), 0, "closed after the last byte");
        assert_eq!((counts.to_listener.load(Relaxed), counts.to_dialler.load(Relaxed)), (5, 3));
    }
}
