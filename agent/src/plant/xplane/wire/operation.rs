//! CMND: runs a command; SIMO: saves or loads a situation or a movie; ALRT: shows a message; QUIT and SHUT: end X-Plane.

use super::{Tag, WireError, begin, body, body_of_size, fits, path, put_text, text};

/// Tag of a [`Command`].
pub const CMND: Tag = *b"CMND";
/// Tag of a [`Situation`].
pub const SIMO: Tag = *b"SIMO";
/// Tag of an [`Alert`].
pub const ALRT: Tag = *b"ALRT";

/// Runs a command once, as if a key had been pressed and released.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Command<'a> {
    /// Path of the command.
    pub path: &'a str,
}

impl<'a> Command<'a> {
    /// Decodes a command; its path ends at the first NUL or with the datagram.
    ///
    /// # Errors
    /// If the datagram is not a command, or its path is empty or not printable.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let text = body(datagram, &CMND)?.split(|&byte| byte == 0).next().unwrap_or_default();
        if text.is_empty() { Err(WireError::NotText) } else { Ok(Self { path: path(text)? }) }
    }

    /// Encodes the command, with a NUL behind its path of at most 499 bytes.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        fits(self.path, 499)?;
        begin(out, &CMND, 0);
        put_text(out, self.path, self.path.len() + 1);
        Ok(())
    }
}

/// What is done with a file of X-Plane.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileAction {
    /// Save the situation.
    SaveSituation,
    /// Load a situation.
    LoadSituation,
    /// Save the movie.
    SaveMovie,
    /// Load a movie.
    LoadMovie,
}

impl FileAction {
    /// All actions, in the order of their numbers on the wire.
    pub const ALL: [Self; 4] = [Self::SaveSituation, Self::LoadSituation, Self::SaveMovie, Self::LoadMovie];
}

/// Saves or loads a situation or a movie.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Situation<'a> {
    /// What is done.
    pub action: FileAction,
    /// Path of the file below X-Plane's folder, at most 149 bytes.
    pub path: &'a str,
}

impl<'a> Situation<'a> {
    const SIZE: usize = 161;

    /// Decodes the message.
    ///
    /// # Errors
    /// If the datagram is not this message, or the action is unknown.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &SIMO, Self::SIZE)?;
        let number = usize::try_from(fields.i32()?).map_err(|_| WireError::OutOfRange)?;
        let action = *FileAction::ALL.get(number).ok_or(WireError::OutOfRange)?;
        Ok(Self { action, path: text(fields.field(152)?)? })
    }

    /// Encodes the message.
    ///
    /// # Errors
    /// If the path is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        fits(self.path, 149)?;
        begin(out, &SIMO, 0);
        out.extend((self.action as i32).to_le_bytes());
        put_text(out, self.path, 152);
        Ok(())
    }
}

/// Shows a message, and blocks X-Plane's screen until its user closes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Alert<'a> {
    /// Four lines of at most 239 bytes.
    pub lines: [&'a str; 4],
}

impl<'a> Alert<'a> {
    const SIZE: usize = 965;

    /// Decodes the message.
    ///
    /// # Errors
    /// If the datagram is not this message, or a line is not text.
    pub fn decode(datagram: &'a [u8]) -> Result<Self, WireError> {
        let mut fields = body_of_size(datagram, &ALRT, Self::SIZE)?;
        let mut lines = [""; 4];
        for line in &mut lines {
            *line = text(fields.field(240)?)?;
        }
        Ok(Self { lines })
    }

    /// Encodes the message.
    ///
    /// # Errors
    /// If a line is too long or contains a NUL.
    pub fn encode(&self, out: &mut Vec<u8>) -> Result<(), WireError> {
        self.lines.iter().try_for_each(|line| fits(line, 239))?;
        begin(out, &ALRT, 0);
        self.lines.iter().for_each(|line| put_text(out, line, 240));
        Ok(())
    }
}

/// Ends X-Plane. Skein never sends it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// QUIT: ends the program.
    Quit,
    /// SHUT: shuts the computer down.
    ShutDown,
}

impl End {
    /// Both messages.
    pub const ALL: [Self; 2] = [Self::Quit, Self::ShutDown];

    /// Tag of the message.
    pub fn tag(self) -> Tag {
        match self {
            Self::Quit => *b"QUIT",
            Self::ShutDown => *b"SHUT",
        }
    }

    /// Decodes the message.
    ///
    /// # Errors
    /// If the datagram is neither of them.
    pub fn decode(datagram: &[u8]) -> Result<Self, WireError> {
        let end = Self::ALL.into_iter().find(|end| datagram.starts_with(&end.tag())).ok_or(WireError::WrongTag)?;
        body_of_size(datagram, &end.tag(), 5).map(|_| end)
    }

    /// Encodes the message.
    pub fn encode(self, out: &mut Vec<u8>) {
        begin(out, &self.tag(), 0);
    }
}
