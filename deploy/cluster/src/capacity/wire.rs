//! Calculates the bytes of a message on the wire: by the paper's equation, and with the overhead of Ethernet, IP, UDP
//! and TCP.

use serde::Serialize;

/// Ethernet overhead: 14 bytes of header, 4 of check sequence (IEEE 802.3).
const FRAME_BYTES: usize = 14 + 4;
/// Preamble and start delimiter before a frame and the smallest gap after it, in bytes during which no other frame can
/// be sent.
const AROUND_A_FRAME_BYTES: usize = 8 + 12;
/// Smallest content of a frame, bytes; shorter content is padded.
const LEAST_CONTENT_BYTES: usize = 46;
/// IPv4 header without options, bytes.
const IP_BYTES: usize = 20;
/// UDP header, bytes.
const UDP_BYTES: usize = 8;
/// TCP header with the time stamps that Linux adds, bytes.
const TCP_BYTES: usize = 20 + 12;

/// Bytes on the wire of a UDP datagram that fits into one frame (payload up to 1472 bytes), as all of Skein's do.
pub fn of_datagram_bytes(payload_bytes: usize) -> usize {
    of_packet_bytes(payload_bytes + UDP_BYTES + IP_BYTES)
}

/// Bytes on the wire of a TCP segment that fits into one frame. Without payload it is an acknowledgement.
pub fn of_segment_bytes(payload_bytes: usize) -> usize {
    of_packet_bytes(payload_bytes + TCP_BYTES + IP_BYTES)
}

fn of_packet_bytes(packet_bytes: usize) -> usize {
    packet_bytes.max(LEAST_CONTENT_BYTES) + FRAME_BYTES + AROUND_A_FRAME_BYTES
}

/// Bytes of a datagram of X-Plane's data output: five of header, and rows of an index and eight values.
pub const fn data_output_bytes(rows: usize) -> usize {
    5 + 36 * rows
}

/// The equation of Garcia & Barnes 2010 for the number of simulators that one central controller can receive:
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PaperEquation {
    /// R_net: capacity of the network, bit/s.
    pub network_bit_s: f64,
    /// P_head: header of a datagram, bit.
    pub head_bit: f64,
    /// N_msg: number of rows in a datagram.
    pub messages: f64,
    /// D_size: size of a row, bit.
    pub message_bit: f64,
    /// F: datagrams a second, Hz.
    pub rate_hz: f64,
}

impl PaperEquation {
    /// The paper's numbers.
    pub const PAPER: Self =
        Self { network_bit_s: 1e9, head_bit: 40.0, messages: 7.0, message_bit: 288.0, rate_hz: 50.0 };

    /// N: the number of vehicles, rounded down.
    pub fn vehicles(&self) -> f64 {
        (self.network_bit_s / ((self.head_bit + self.messages * self.message_bit) * self.rate_hz)).floor()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_equation_gives_the_papers_number() {
        assert_eq!(PaperEquation::PAPER.vehicles(), 9_727.0);
        let twice = PaperEquation { rate_hz: 100.0, ..PaperEquation::PAPER };
        assert_eq!(twice.vehicles(), 4_863.0);
        let rows = PaperEquation::PAPER.messages as usize;
        let payload_bit =
            PaperEquation::PAPER.head_bit + PaperEquation::PAPER.messages * PaperEquation::PAPER.message_bit;
        assert_eq!(
            8.0 * data_output_bytes(rows) as f64,
            payload_bit,
            "its message is a row, its head the datagram's header"
        );
    }

    #[test]
    fn frames_are_as_long_as_counted_by_hand() {
        // 257 + UDP 8 + IP 20 = 285; header 14, check 4, preamble 8, gap 12.
        assert_eq!(of_datagram_bytes(257), 323);
        // X-Plane's RPOS and DREF.
        assert_eq!((of_datagram_bytes(69), of_datagram_bytes(509)), (135, 575));
        // Padded: nothing takes less than 84 bytes.
        assert_eq!((of_datagram_bytes(0), of_datagram_bytes(18), of_datagram_bytes(19)), (84, 84, 85));
        // An acknowledgement: TCP 32 + IP 20 = 52.
        assert_eq!(of_segment_bytes(0), 90);
        assert_eq!(of_segment_bytes(100), 190);
    }
}
