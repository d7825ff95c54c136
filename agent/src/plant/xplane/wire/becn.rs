//! BECN: about once a second, by multicast, X-Plane says that it is there and on which port it listens.

use super::{Fields, Tag, WireError, begin, body};

/// The message's letters.
pub const TAG: Tag = *b"BECN";
/// The multicast group of the beacon.
pub const GROUP: [u8; 4] = [239, 255, 1, 1];
/// The UDP port of the beacon.
pub const PORT: u16 = 49707;

/// The layout read and written here. A higher minor version only appends fields.
const MAJOR: u8 = 1;
/// X-Plane's RakNet multiplayer port, which answers no dataref requests.
pub const RAKNET_PORT: u16 = 49010;

/// A beacon. It carries no address: that is the datagram's source.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Beacon {
    /// 1 up to X-Plane 11.4; from 2 (11.50) on, the RakNet port follows the name.
    pub minor: u8,
    /// 1 is X-Plane, 2 is Plane Maker.
    pub host_id: i32,
    /// 121400 is 12.1.4.
    pub version: i32,
    /// 1 master, 2 external visual, 3 instructor's station.
    pub role: u32,
    /// The UDP port on which this X-Plane receives.
    pub port: u16,
    /// The computer's name.
    pub name: String,
    /// From minor version 2 on.
    pub raknet_port: Option<u16>,
}

/// Bytes before the name.
const FIXED: usize = 21;

impl Beacon {
    /// An X-Plane that flies its own aircraft, as opposed to Plane Maker or a machine that only shows its outside.
    pub fn is_master(&self) -> bool {
        self.host_id == 1 && self.role == 1
    }

    /// Reads a beacon of any minor version, its name cut after the NUL (as on the wire) or filling its 500 bytes (as in
    /// print). A name that is not UTF-8 is repaired: it is only shown.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let mut fields = Fields(body(datagram, &TAG)?);
        let (major, minor) = (fields.u8()?, fields.u8()?);
        if major != MAJOR {
            return Err(WireError::Incompatible);
        }
        let beacon = Self {
            minor,
            host_id: fields.i32()?,
            version: fields.i32()?,
            role: fields.u32()?,
            port: fields.u16()?,
            name: String::from_utf8_lossy(fields.text()).into_owned(),
            raknet_port: match datagram.last_chunk::<2>() {
                Some(port) if minor >= 2 && datagram.len() >= FIXED + 3 => Some(u16::from_le_bytes(*port)),
                _ => None,
            },
        };
        if beacon.port == 0 { Err(WireError::OutOfRange) } else { Ok(beacon) }
    }

    /// Writes the beacon, its name cut after the NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        if self.name.contains('\0') {
            return Err(WireError::NotText);
        }
        if self.name.len() >= 500 {
            return Err(WireError::TooLong);
        }
        begin(out, &TAG, 0);
        out.extend([MAJOR, self.minor]);
        out.extend(self.host_id.to_le_bytes());
        out.extend(self.version.to_le_bytes());
        out.extend(self.role.to_le_bytes());
        out.extend(self.port.to_le_bytes());
        out.extend_from_slice(self.name.as_bytes());
        out.push(0);
        out.extend(self.raknet_port.map(u16::to_le_bytes).into_iter().flatten());
        Ok(())
    }
}
