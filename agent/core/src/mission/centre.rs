//! The moving centre that all share without sharing a clock.
//!
//! Where the centre is on its path is s, metres from the path's beginning. Every agent integrates its own,
//!
//! ṡ_i = clamp( v + κ Σ_j (s_j − s_i), 0, 2v ),   κ = 0.5/N 1/s,
//!
//! over the live members j that are at the same step, tells it with its part in the agreement, and never goes back. All
//! run at v; a difference dies away at about κN and stays within v times the age of the words.

use super::plan::Path;

/// κN, 1/s: how fast differences die away.
const CONSENSUS_PER_S: f64 = 0.5;

/// ṡ for the own progress, the others' at the same step, and `live` members at all; m/s. Zero at the path's end.
pub fn speed_m_s(path: &Path, own_m: f64, others_m: impl Iterator<Item = f64>, live: usize) -> f64 {
    if own_m >= path.length_m() {
        return 0.0;
    }
    let ahead_m: f64 = others_m.map(|other_m| other_m - own_m).sum();
    (path.speed_m_s + CONSENSUS_PER_S / live.max(1) as f64 * ahead_m).clamp(0.0, 2.0 * path.speed_m_s)
}
