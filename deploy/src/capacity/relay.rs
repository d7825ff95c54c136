//! A wire that can be read: carries one TCP connection to its other end and counts what goes by.

use std::io::{self, Read, Write};
use std::net::{Ipv4Addr, Shutdown, SocketAddr, TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use std::thread;

/// Bytes of payload that have gone each way.
#[derive(Debug, Default)]
pub(super) struct Counts {
    /// From who listens to who dials.
    pub(super) to_dialler: AtomicU64,
    /// From who dials to who listens.
    pub(super) to_listener: AtomicU64,
}

/// Where to dial instead of `listener`, and what goes by. It carries one connection and ends with it.
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

/// Until either end closes.
fn carry(mut from: TcpStream, mut to: TcpStream, count: &AtomicU64) {
    let mut buffer = [0; 65_536];
    while let Ok(size) = from.read(&mut buffer) {
        // Counted first: whoever has it finds it counted.
        count.fetch_add(size as u64, Relaxed);
        if size == 0 || to.write_all(&buffer[..size]).is_err() {
            break;
        }
    }
    // It may be closed already.
    let _ = to.shutdown(Shutdown::Both);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_goes_by_is_counted_each_way() {
        let end = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let (address, counts) = open(end.local_addr().unwrap()).unwrap();
        let mut dialler = TcpStream::connect(address).unwrap();
        let (mut listener, _) = end.accept().unwrap();
        let mut heard = [0; 5];
        dialler.write_all(b"hello").unwrap();
        listener.read_exact(&mut heard).unwrap();
        assert_eq!(&heard, b"hello");
        listener.write_all(b"yes").unwrap();
        dialler.read_exact(&mut heard[..3]).unwrap();
        drop(listener);
        assert_eq!(dialler.read(&mut heard).unwrap(), 0, "closed behind what was said");
        assert_eq!((counts.to_listener.load(Relaxed), counts.to_dialler.load(Relaxed)), (5, 3));
    }
}
