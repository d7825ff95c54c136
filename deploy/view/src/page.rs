//! The files of the page, which are part of the program: it works without internet.

/// The files by name, with their content.
macro_rules! files {
    ($($name:literal),* $(,)?) => {
        &[$(($name, include_str!(concat!("page/", $name)))),*]
    };
}

/// Every file of the folder `page`.
const FILES: &[(&str, &str)] = files![
    "camera.js",
    "connection.js",
    "detail.js",
    "dom.js",
    "events.js",
    "favicon.svg",
    "format.js",
    "frame.js",
    "history.js",
    "index.html",
    "keys.js",
    "main.js",
    "map-crowd.js",
    "map-ground.js",
    "map-links.js",
    "map-vehicles.js",
    "map.js",
    "matrix.js",
    "orders.js",
    "player.js",
    "plot.js",
    "plots.js",
    "reception.js",
    "schedule.js",
    "status.js",
    "style.css",
    "swarm.js",
    "table.js",
    "theme.js",
    "time-bar.js",
];

/// Kind and content of a file.
pub(super) fn file(name: &str) -> Option<(&'static str, &'static str)> {
    let (name, content) = FILES.iter().find(|(known, _)| *known == name)?;
    let kind = match name.rsplit_once('.')?.1 {
        "html" => "text/html; charset=utf-8",
        "css" => "text/css; charset=utf-8",
        "js" => "text/javascript; charset=utf-8",
        "svg" => "image/svg+xml",
        _ => "text/plain; charset=utf-8",
    };
    Some((kind, content))
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;
    use std::path::Path;

    use super::*;

    #[test]
    fn every_file_of_the_folder_is_served() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/page");
        let names = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
        let served: BTreeSet<String> = FILES.iter().map(|(name, _)| (*name).to_owned()).collect();
        assert_eq!(names.collect::<BTreeSet<_>>(), served);
        assert!(file("main.js").is_some_and(|(kind, _)| kind.starts_with("text/javascript")));
        assert_eq!(file("../page.rs"), None);
    }
}
