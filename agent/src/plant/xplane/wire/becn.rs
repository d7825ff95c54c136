//! BECN: the beacon by which X-Plane announces itself and its port, by multicast about once a second.

use super::{Fields, Packed, Tag, WireError, begin, body, put_text};

/// Tag of the message.
pub const TAG: Tag = *b"BECN";
/// Multicast group of the beacon.
pub const GROUP: [u8; 4] = [239, 255, 1, 1];
/// UDP port of the beacon.
pub const PORT: u16 = 49707;

/// Major version of the layout. A higher minor version only appends fields.
const MAJOR: u8 = 1;
/// X-Plane's RakNet multiplayer port, which does not serve datarefs.
pub const RAKNET_PORT: u16 = 49010;

/// Contents of a beacon. Its address is the source of the datagram.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Beacon {
    /// 1 up to X-Plane 11.4; from 2 (11.50) on, the RakNet port follows the name.
    pub minor: u8,
    /// Program: 1 is X-Plane, 2 is Plane Maker.
    pub host_id: i32,
    /// Version number of X-Plane: 121400 is 12.1.4.
    pub version: i32,
    /// Role: 1 master, 2 external visual, 3 instructor's station.
    pub role: u32,
    /// UDP port on which this X-Plane receives.
    pub port: u16,
    /// Name of the computer.
    pub name: String,
    /// RakNet port, present from minor version 2 on.
    pub raknet_port: Option<u16>,
}

/// Number of bytes before the name.
const FIXED: usize = 21;
/// Longest name, bytes: a NUL follows it.
const MAX_NAME: usize = 499;

impl Beacon {
    /// Whether this X-Plane flies its own aircraft, unlike Plane Maker or an external visual.
    pub fn is_master(&self) -> bool {
        self.host_id == 1 && self.role == 1
    }

    /// Decodes a beacon of any minor version. Its name ends after the NUL (as X-Plane sends it) or fills 500 bytes (as
    /// documented). A name that is not UTF-8 is repaired, because it is only displayed.
    ///
    /// # Errors
    /// If the datagram is not a beacon of this major version.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let mut fields = Fields(body(datagram, &TAG)?);
        let (major, minor) = (fields.next::<u8>()?, fields.next()?);
        if major != MAJOR {
            return Err(WireError::Incompatible);
        }
        let (host_id, version, role, port) = (fields.next()?, fields.next()?, fields.next()?, fields.next()?);
        let name = fields.text();
        let raknet_port = match datagram.last_chunk::<2>() {
            // Behind the NUL of the name: a beacon may end with its name.
            Some(port) if minor >= 2 && datagram.len() >= FIXED + name.len() + 3 => Some(u16::from_le_bytes(*port)),
            _ => None,
        };
        let name = String::from_utf8_lossy(name).into_owned();
        let beacon = Self { minor, host_id, version, role, port, name, raknet_port };
        if beacon.port == 0 { Err(WireError::OutOfRange) } else { Ok(beacon) }
    }

    /// Encodes the beacon; its name ends after the NUL.
    ///
    /// # Errors
    /// If the name is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        begin(out, &TAG);
        out.extend([MAJOR, self.minor]);
        self.host_id.write(out);
        self.version.write(out);
        self.role.write(out);
        self.port.write(out);
        put_text(out, &self.name, MAX_NAME, self.name.len() + 1)?;
        self.raknet_port.iter().for_each(|port| port.write(out));
        Ok(())
    }
}
