//! Draws a report of flights as one page with figures and tables (`skein report`).

pub mod figure;
mod fleet;
pub mod flight;
pub mod page;
mod scenarios;
mod study;
mod tables;
pub mod verdict;

use std::fs;
use std::path::{Path, PathBuf};

use crate::compare::folder::Folder;
use crate::error::Error;
use crate::metrics::Measured;
use crate::out;
use crate::record;
use crate::recording::Recording;
use crate::terminal::complain;
use page::{Page, Part, Section, Tone};

/// The command-line arguments of `skein report`.
#[derive(Clone, Debug, clap::Args)]
#[command(after_help = "Examples:\n  skein report my-study\n  skein report my-study/seed-3/run.mcap --csv")]
pub struct ReportArgs {
    /// Folder of a run or a study, a folder of scenarios (these are flown in virtual time), or a recording
    #[arg(value_name = "DIR|FILE.mcap")]
    pub of: PathBuf,
    /// Folder for what is written, new or empty; without it a new one in skein-runs
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Write the recordings as tables too
    #[arg(long)]
    pub csv: bool,
}

/// Reads or flies the runs, draws their figures, and writes the page.
///
/// # Errors
/// There is nothing to report on, or the page cannot be written.
pub fn run(ReportArgs { of, out, csv }: &ReportArgs) -> Result<(), Error> {
    let out = out::folder(out.as_deref(), &format!("{}-report", stem(of)))?;
    let recordings = if *csv { recordings(of)? } else { Vec::new() };
    let page = page(of)?;
    page.write(&out)?;
    page.sentences(Tone::Missing).for_each(complain);
    for (name, path) in recordings {
        let failed = |error: record::RecordError| Error::Failed(error.to_string());
        record::csv(&path, &out.join("csv").join(name)).map_err(failed)?;
    }
    eprintln!("written to {}", out.join("index.html").display());
    match page.sentences(Tone::CutOff).collect::<Vec<_>>().as_slice() {
        [] => Ok(()),
        cut => Err(Error::Failed(format!("{}: {}", of.display(), cut.join(" ")))),
    }
}

/// Makes the page about a recording, a folder of runs or a folder of scenarios.
fn page(of: &Path) -> Result<Page, Error> {
    if of.is_file() {
        if let Some(section) = fleet::of_file(of, stem(of))? {
            let about = of.display().to_string();
            return Ok(Page { title: stem(of), about, verdict: Vec::new(), sections: vec![section] });
        }
        let (recording, title) = recording(of)?;
        let about = flight::subject(&recording.run);
        let measured = figures_beside(of);
        let verdict = verdict::of_flight(&recording, measured.as_ref());
        let mut parts = flight_parts(&recording);
        parts.extend(measured.as_ref().map(tables::of_run));
        let section = Section { title: "The flight".to_owned(), name: stem(of), parts };
        return Ok(Page { title, about, verdict, sections: vec![section] });
    }
    let scenarios = scenarios::in_folder(of)?;
    // The folder of a run also contains a scenario.
    if scenarios.is_empty() || of.join("metrics.json").exists() {
        return study::page(&Folder::read(of)?);
    }
    scenarios::page(of, &scenarios)
}

/// The figures of a recording in the folder of its run; `None` for a recording that lies elsewhere.
fn figures_beside(recording: &Path) -> Option<Measured> {
    let is_of_run = recording.file_name().is_some_and(|name| name == record::FILE);
    let text = is_of_run.then(|| fs::read_to_string(recording.with_file_name("metrics.json")).ok())??;
    Measured::read(&text).ok()
}

/// Finds all recordings at this path, each with a name.
fn recordings(of: &Path) -> Result<Vec<(String, PathBuf)>, Error> {
    if of.is_file() {
        return Ok(vec![(stem(of), of.to_owned())]);
    }
    let runs = Folder::read(of)?.runs.into_iter().map(|run| run.folder.join(record::FILE));
    let name = |path: &Path| {
        let folder =
            path.parent().and_then(|folder| folder.strip_prefix(of).ok()).filter(|inside| *inside != Path::new(""));
        folder.map_or_else(|| stem(path), |folder| slug(&folder.display().to_string()))
    };
    let found: Vec<_> = runs.filter(|path| path.is_file()).map(|path| (name(&path), path)).collect();
    if found.is_empty() {
        return Err(Error::Refused(format!("--csv: {} contains no recording", of.display())));
    }
    Ok(found)
}

/// Reads a recording and makes its title.
fn recording(path: &Path) -> Result<(Recording, String), Error> {
    let recording = record::read(path).map_err(|error| Error::Refused(error.to_string()))?;
    let title = format!("{}, seed {}", recording.run.scenario, recording.run.seed);
    Ok((recording, title))
}

/// All figures of a flight.
fn flight_parts(recording: &Recording) -> Vec<Part> {
    flight::figures(recording).into_iter().map(Part::Drawing).collect()
}

/// The last component of a path without its extension, as a file name.
fn stem(path: &Path) -> String {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    let stem = absolute.file_stem().unwrap_or_default().to_string_lossy();
    slug(&stem)
}

/// Replaces all characters that are not safe in file names.
fn slug(name: &str) -> String {
    name.chars().map(|letter| if letter.is_alphanumeric() || letter == '_' { letter } else { '-' }).collect()
}
