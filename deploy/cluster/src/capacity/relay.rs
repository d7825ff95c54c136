//! A relay that counts the bytes of one TCP connection.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;

/// Opens a relay to `listener`; returns the address to dial instead, and the number of payload bytes that have passed from the
/// listening to the dialling end. It carries one connection and ends with it.
pub(super) fn open(listener: SocketAddr) -> io::Result<(SocketAddr, Arc<AtomicU64>)> {
    let front = TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?;
    let address = front.local_addr()?;
    let to_dialler = Arc::new(AtomicU64::new(0));
    let counted = to_dialler.clone();
    thread::spawn(move || -> io::Result<()> {
        let (dialler, _) = front.accept()?;
        let listener = TcpStream::connect(listener)?;
        dialler.set_nodelay(true)?;
        listener.set_nodelay(true)?;
        let (from, to) = (dialler.try_clone()?, listener.try_clone()?);
        thread::spawn(move || carry(from, to, &AtomicU64::new(0)));
        carry(listener, dialler, &counted);
        Ok(())
    });
    Ok((address, to_dialler))
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
    fn the_bytes_to_the_dialling_end_are_counted() {
        let end = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let (address, to_dialler) = open(end.local_addr().unwrap()).unwrap();
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
        assert_eq!(to_dialler.load(Relaxed), 3);
    }
}
