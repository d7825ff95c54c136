//! A self-contained HTML page with text, tables and figures.

use std::fs;
use std::path::{Path, PathBuf};

use super::figure::{Drawing, escaped};
use crate::error::Error;
use crate::out;
use skein_host::parallel::{cores, in_parallel};

/// Length of a cell above which its column counts as text and is aligned to the left, characters.
const LONG: usize = 28;
/// Style sheet of the page. It loads no scripts, fonts or anything else from elsewhere.
const STYLE: &str = include_str!("page.css");

/// A report as one page.
#[derive(Clone, Debug)]
pub struct Page {
    /// Title of the page.
    pub title: String,
    /// Line below the title.
    pub about: String,
    /// The verdict: what flew, and how it went.
    pub verdict: Vec<Line>,
    /// Sections, in their order on the page.
    pub sections: Vec<Section>,
}

/// A line of a verdict.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Line {
    /// The meaning of its text.
    pub tone: Tone,
    /// Whole sentences.
    pub text: String,
}

/// The meaning of a line of a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tone {
    /// Neither good nor bad.
    Plain,
    /// Something is as it should be.
    Good,
    /// Something failed.
    Bad,
    /// Something was not recorded, and the rest is shown.
    Missing,
    /// The end of a flight was not recorded: how it ended is unknown.
    CutOff,
}

/// A section of a page.
#[derive(Clone, Debug)]
pub struct Section {
    /// Title of the section.
    pub title: String,
    /// Unique name of the section, and prefix of the file names of its figures.
    pub name: String,
    /// Parts, in their order on the page.
    pub parts: Vec<Part>,
}

/// One part of a section.
#[derive(Clone, Debug)]
pub enum Part {
    /// A paragraph.
    Text(String),
    /// The verdict on what the section shows.
    Verdict(Vec<Line>),
    /// A table.
    Table {
        /// Caption above the table.
        caption: String,
        /// Titles of the columns.
        head: Vec<String>,
        /// Rows, each as long as the head; the first cell names the row.
        rows: Vec<Vec<String>>,
    },
    /// A figure.
    Drawing(Drawing),
}

impl Page {
    /// The sentences of this tone in all verdicts of the page.
    pub fn sentences(&self, tone: Tone) -> impl Iterator<Item = &str> {
        let of_sections = self.sections.iter().flat_map(|section| &section.parts).filter_map(|part| match part {
            Part::Verdict(lines) => Some(lines),
            _ => None,
        });
        let lines = [&self.verdict].into_iter().chain(of_sections).flatten();
        lines.filter(move |line| line.tone == tone).map(|line| line.text.as_str())
    }

    /// Writes `index.html` into the folder, and each figure as SVG and PNG into its `figures`.
    ///
    /// # Errors
    /// A file cannot be written, or a figure cannot be drawn.
    pub fn write(&self, out: &Path) -> Result<(), Error> {
        let failed = |path: &Path, error| Error::Failed(format!("{}: {error}", path.display()));
        let _claim = out::claim(out)?;
        let folder = out.join("figures");
        fs::create_dir_all(&folder).map_err(|error| failed(&folder, error))?;
        let put = |path: PathBuf, text: &str| out::write(&path, text);

        let mut body = String::new();
        let mut figures = Vec::new();
        for section in &self.sections {
            body += &format!("<section id=\"{}\">\n<h2>{}</h2>\n", escaped(&section.name), escaped(&section.title));
            for part in &section.parts {
                let Part::Drawing(figure) = part else {
                    body += &part.html();
                    continue;
                };
                let (name, svg) = (format!("{}-{}", section.name, figure.name), figure.svg());
                body += &shown(figure, &name, &svg);
                put(folder.join(format!("{name}.svg")), &svg)?;
                figures.push((folder.join(format!("{name}.png")), figure));
            }
            body += "</section>\n";
        }
        put(out.join("index.html"), &self.html(&body))?;
        // On all cores, because the compression of PNG files takes longer than everything else in a report.
        in_parallel(figures.len(), cores(), |nth| figures[nth].1.write_png(&figures[nth].0)).map(drop)
    }

    fn html(&self, body: &str) -> String {
        let (title, about, verdict) = (escaped(&self.title), escaped(&self.about), verdict_html(&self.verdict));
        let link = |section: &Section| {
            format!("<li><a href=\"#{}\">{}</a></li>\n", escaped(&section.name), escaped(&section.title))
        };
        let contents: String =
            if self.sections.len() > 1 { self.sections.iter().map(link).collect() } else { String::new() };
        let contents = if contents.is_empty() { contents } else { format!("<nav><ol>\n{contents}</ol></nav>\n") };
        format!(
            "<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
             <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n\
             <title>{title}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n<main>\n\
             <h1>{title}</h1>\n<p class=\"about\">{about}</p>\n{verdict}{contents}{body}</main>\n</body>\n</html>\n"
        )
    }
}

impl Part {
    fn html(&self) -> String {
        match self {
            Self::Text(text) => format!("<p>{}</p>\n", escaped(text)),
            Self::Verdict(lines) => verdict_html(lines),
            Self::Table { caption, head, rows } => {
                let is_long = |column: usize| rows.iter().any(|row| row[column].chars().count() > LONG);
                let is_text: Vec<bool> = (0..head.len()).map(is_long).collect();
                let cells = |tag: &str, cells: &[String]| -> String {
                    let cell = |(text, is_text): (&String, &bool)| {
                        let class = if *is_text { " class=\"text\"" } else { "" };
                        format!("<{tag}{class}>{}</{tag}>", escaped(text))
                    };
                    format!("<tr>{}</tr>\n", cells.iter().zip(&is_text).map(cell).collect::<String>())
                };
                let body: String = rows.iter().map(|row| cells("td", row)).collect();
                let head = cells("th", head);
                let caption = escaped(caption);
                format!(
                    "<div class=\"wide\"><table>\n<caption>{caption}</caption>\n<thead>{head}</thead>\n<tbody>\n{body}</tbody>\n</table></div>\n"
                )
            }
            Self::Drawing(_) => String::new(),
        }
    }
}

/// The HTML of a verdict: its lines below each other, each with a sign for good or bad beside its colour.
fn verdict_html(lines: &[Line]) -> String {
    let line = |Line { tone, text }: &Line| {
        let (class, sign) = match tone {
            Tone::Plain => ("plain", ""),
            Tone::Good => ("good", "<b aria-label=\"good\">✓</b> "),
            Tone::Bad => ("bad", "<b aria-label=\"failed\">✗</b> "),
            Tone::Missing | Tone::CutOff => ("bad", "<b aria-label=\"missing\">?</b> "),
        };
        format!("<p class=\"{class}\">{sign}{}</p>\n", escaped(text))
    };
    let lines: String = lines.iter().map(line).collect();
    if lines.is_empty() { lines } else { format!("<div class=\"verdict\">\n{lines}</div>\n") }
}

/// The HTML of a figure, with links to its files.
fn shown(figure: &Drawing, name: &str, svg: &str) -> String {
    let files =
        ["svg", "png"].map(|ending| format!("<a href=\"figures/{name}.{ending}\">{}</a>", ending.to_uppercase()));
    let caption = escaped(&figure.full_caption());
    let svg = format!("<div class=\"wide\">{svg}</div>");
    format!("<figure id=\"{name}\">\n{svg}<figcaption>{caption} {}</figcaption>\n</figure>\n", files.join(" "))
}
