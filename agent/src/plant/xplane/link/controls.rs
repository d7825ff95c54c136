//! Sends the datagrams that hold and set the controls. They are encoded once and sent again with other values.

use std::net::SocketAddr;

use crate::plant::xplane::socket::Port;
use crate::plant::xplane::wire::WireError;
use crate::plant::xplane::wire::dref::Template;
use skein_core::aircraft::{Dataref, Profile};
use skein_core::plant::Controls;

/// One datagram template for each dataref of the aircraft's profile.
pub(super) struct ControlWriter {
    overrides: Vec<Template>,
    hold: Vec<(Template, f32)>,
    roll: Template,
    pitch: Template,
    yaw: Template,
    collective: Vec<Template>,
}

impl ControlWriter {
    pub(super) fn new(profile: &Profile) -> Result<Self, WireError> {
        let template = |dataref: &Dataref| Template::new(dataref.as_str());
        let held = |(dataref, &value): (&Dataref, &f32)| Ok((template(dataref)?, value));
        Ok(Self {
            overrides: profile.overrides.iter().map(template).collect::<Result<_, _>>()?,
            hold: profile.hold.iter().map(held).collect::<Result<_, WireError>>()?,
            roll: template(&profile.roll)?,
            pitch: template(&profile.pitch)?,
            yaw: template(&profile.yaw)?,
            collective: profile.collective.iter().map(template).collect::<Result<_, _>>()?,
        })
    }

    /// Takes the controls, or confirms that they are taken: X-Plane forgets it when the aircraft is reloaded.
    pub(super) fn take(&mut self, port: &mut Port, to: SocketAddr) {
        self.set_overrides(1.0, port, to);
        for (template, value) in &mut self.hold {
            send(port, template, *value, to);
        }
    }

    /// Releases the controls.
    pub(super) fn release(&mut self, port: &mut Port, to: SocketAddr) {
        self.set_overrides(0.0, port, to);
    }

    fn set_overrides(&mut self, value: f32, port: &mut Port, to: SocketAddr) {
        for template in &mut self.overrides {
            send(port, template, value, to);
        }
    }

    /// Sets the controls.
    pub(super) fn set(&mut self, controls: Controls, port: &mut Port, to: SocketAddr) {
        send(port, &mut self.roll, controls.roll as f32, to);
        send(port, &mut self.pitch, controls.pitch as f32, to);
        send(port, &mut self.yaw, controls.yaw as f32, to);
        for template in &mut self.collective {
            send(port, template, controls.collective as f32, to);
        }
    }
}

/// Sends a write. A lost one is repeated with the next frame; the port counts errors.
fn send(port: &mut Port, template: &mut Template, value: f32, to: SocketAddr) {
    let _ = port.send(template.with_value(value), to);
}
