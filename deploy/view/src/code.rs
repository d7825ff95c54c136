//! The page's address as a QR code on the terminal, for the camera of a phone.

use std::net::SocketAddr;

use qrcode::render::unicode::Dense1x2;
use qrcode::{EcLevel, QrCode};
use ratatui::crossterm::terminal;
use skein_lab::terminal::{draw, obeys_escapes, shows_colours};

/// The code of the first address that another device can open; `None` if the page is served on the loopback only.
pub(super) fn of(addresses: &[SocketAddr]) -> Option<String> {
    let address = addresses.iter().find(|address| !address.ip().is_loopback())?;
    let code = QrCode::with_error_correction_level(format!("http://{address}/"), EcLevel::L).ok()?;
    // Light modules are drawn, dark ones are the terminal's ground: most terminals are dark.
    Some(code.render::<Dense1x2>().dark_color(Dense1x2::Light).light_color(Dense1x2::Dark).build())
}

/// Prints a code, if stdout is a terminal that shows it.
pub(super) fn show(code: &str) {
    let stdout = std::io::stdout();
    let width = code.lines().map(|line| line.chars().count()).max().unwrap_or(0);
    let fits = terminal::size().is_ok_and(|(columns, _)| usize::from(columns) >= width);
    if !obeys_escapes(&stdout) || !fits || !shows_blocks(|name| std::env::var(name).ok()) {
        return;
    }
    // White on black, whatever the terminal's colours are: not every camera reads a code with exchanged colours.
    let line = |line: &str| match shows_colours(&stdout) {
        true => format!("\u{1b}[97;40m{line}\u{1b}[0m\n"),
        false => format!("{line}\n"),
    };
    draw(&code.lines().map(line).collect::<String>());
}

/// Whether the terminal shows characters beyond ASCII, by the locale.
fn shows_blocks(variable: impl Fn(&str) -> Option<String>) -> bool {
    let locale =
        ["LC_ALL", "LC_CTYPE", "LANG"].iter().find_map(|name| variable(name).filter(|value| !value.is_empty()));
    let is_utf8 = |locale: String| locale.to_ascii_lowercase().replace('-', "").ends_with("utf8");
    cfg!(windows) || locale.is_some_and(is_utf8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_code_is_of_the_first_address_that_a_phone_can_open() {
        let at = |text: &str| text.parse::<SocketAddr>().unwrap();
        assert_eq!(of(&[at("127.0.0.1:7480"), at("[::1]:7480")]), None);
        let code = of(&[at("127.0.0.1:7480"), at("192.168.1.20:7480"), at("10.0.0.7:7480")]).unwrap();
        assert_eq!(Some(&code), of(&[at("192.168.1.20:7480")]).as_ref());
        assert_ne!(Some(&code), of(&[at("10.0.0.7:7480")]).as_ref());
        let lines: Vec<&str> = code.lines().collect();
        let width = lines[0].chars().count();
        assert!(lines.iter().all(|line| line.chars().count() == width), "{code}");
        assert!(width < 40 && lines.len() < 22, "it fits a terminal of 80 by 24:\n{code}");
        // Two rows of modules are a line; the margin of four modules is light.
        assert!(lines[..2].iter().all(|line| line.chars().all(|module| module == '█')), "{code}");
        // The corner of the upper left mark: dark above and below at its edge.
        assert_eq!(lines[2].chars().nth(4), Some(' '), "{code}");
    }

    #[test]
    fn a_code_is_shown_only_where_its_characters_are() {
        let shows = |all: &[(&str, &str)]| {
            shows_blocks(|name| all.iter().find(|(known, _)| *known == name).map(|(_, value)| (*value).to_owned()))
        };
        assert!(shows(&[("LANG", "de_DE.UTF-8")]) && shows(&[("LANG", "C"), ("LC_ALL", "C.utf8")]));
        assert!(!shows(&[("LANG", "de_DE.UTF-8"), ("LC_ALL", "C")]) || cfg!(windows));
        assert!(!shows(&[]) || cfg!(windows));
    }
}
