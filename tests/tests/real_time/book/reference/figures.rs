//! `reference/figures.md`: every figure of `metrics.json`.

use skein_lab::metrics::figures::{FIGURES, Figure};

/// The page.
pub(super) fn page() -> String {
    let body = format!(
        "Times count from the moment when the last agent is an active member. The program takes figures from how the vehicles really \
         flew, not from what their agents estimated. A figure is `null` if it does not apply to the flight, or if its event \
         never happened; in the second case its key is also in `never`. The column *worse* shows whether more or less of a figure is \
         worse.\n\n{}\n\
         `order`, `safety`, `union` and `connectivity` are those of SwarmLab (Soria, Schiano, Floreano 2020). \
         `velocity_correlation`, `collision_risk`, `mean_speed_m_s`, `disconnected_vehicles` and `min_cluster_vehicles` are the order \
         parameters φ of Vásárhelyi et al. (Science Robotics 3, 2018). Both take their graphs from distances; here the graph is which \
         vehicle really receives which other.",
        table()
    );
    let purpose = "After reading this page you can read every figure of `metrics.json`, `runs.csv` and `summary.json`.";
    super::page("Figures", purpose, "the table of figures", &body)
}

/// The table of all figures, in Markdown.
fn table() -> String {
    let row = |figure: &Figure| {
        let (key, unit, worse, meaning) = (figure.key, figure.unit, figure.worse_is(), figure.meaning);
        format!("| `{key}` | {unit} | {worse} | {meaning} |\n")
    };
    let rows: String = FIGURES.iter().map(row).collect();
    format!("| figure | unit | worse | meaning |\n| --- | --- | --- | --- |\n{rows}")
}
