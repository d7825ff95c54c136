//! `reference/vectors.md`: the vectors by which Simulink and others without JSON fly a vehicle.

use skein_host::external::vector::{ANSWER, ASK, PEER, PEERS, Part, QUERY, REPLY};

use super::{head, row};

/// The page.
pub(super) fn page() -> String {
    let (query, peers_at) = table(&QUERY, 1);
    let (peer, next) = table(&PEER, peers_at);
    let every = next - peers_at;
    let (reply, _) = table(&REPLY, 1);
    let body = format!(
        "All values are little-endian 64-bit floating-point numbers, one vector a datagram. Elements are counted from 1.\n\n\
         ## Query\n\n{ASK} values: these, then {PEERS} rows of {every} values for peers.\n\n{query}\n\
         A peer's row; that of the first peer is shown, and each further one is {every} elements later:\n\n{peer}\n\
         ## Reply\n\n{ANSWER} values.\n\n{reply}"
    );
    let purpose =
        "After reading this page you can lay out the vectors of a law in Simulink or another program without JSON.";
    super::page("Vectors of an external law", purpose, "`agent/host/src/external/vector.rs`", &body)
}

/// The table of these parts, of which the first begins at this element; and the element after the last.
fn table(parts: &[Part], first: usize) -> (String, usize) {
    let (mut text, mut next) = (head(&["elements", "meaning"]), first);
    for Part { values, meaning } in parts {
        let last = next + values - 1;
        let elements = if last == next { next.to_string() } else { format!("{next} to {last}") };
        text += &row(&[&elements, meaning]);
        next = last + 1;
    }
    (text, next)
}
