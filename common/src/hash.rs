//! A hash with the same value on every platform, for comparing and for finding damage. It does not protect against forgery.

/// State of [`fnv_1a`] before the first byte.
pub const FNV_1A_START: u64 = 0xcbf2_9ce4_8422_2325;

/// 64-bit FNV-1a (Fowler, Noll, Vo) over these bytes, continued from `state`.
pub fn fnv_1a(bytes: &[u8], state: u64) -> u64 {
    bytes.iter().fold(state, |state, &byte| (state ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test vectors of the authors of FNV.
    #[test]
    fn the_hash_is_fnv_1a() {
        assert_eq!(fnv_1a(b"", FNV_1A_START), 0xcbf2_9ce4_8422_2325);
        assert_eq!(fnv_1a(b"a", FNV_1A_START), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(fnv_1a(b"bar", fnv_1a(b"foo", FNV_1A_START)), 0x8594_4171_f739_67e8);
    }
}
