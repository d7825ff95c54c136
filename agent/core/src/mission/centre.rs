//! The moving centre, shared by all vehicles without a common clock.
//!
//! The centre's progress s is its distance from the beginning of its path, m. Every agent integrates its own,
//!
//! ṡ_i = clamp( v + κ Σ_j (s_j − s_i), 0, 2v ),   κ = 0.5/N 1/s,
//!
//! over the live members j at the same step, sends it in its heartbeat, and never goes back. All run at v; a difference
//! decays at about κN and stays within v times the age of the heartbeats.

use super::plan::Path;

/// Rate κN at which differences decay, 1/s.
const CONSENSUS_PER_S: f64 = 0.5;

/// Rate ṡ for the own progress, the others' progress at the same step, and `live` members in total, m/s. Zero at the
/// path's end.
pub fn speed_m_s(path: &Path, own_m: f64, others_m: impl Iterator<Item = f64>, live: usize) -> f64 {
    if own_m >= path.length_m() {
        return 0.0;
    }
    let ahead_m: f64 = others_m.map(|other_m| other_m - own_m).sum();
    (path.speed_m_s + CONSENSUS_PER_S / live.max(1) as f64 * ahead_m).clamp(0.0, 2.0 * path.speed_m_s)
}
