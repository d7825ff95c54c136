//! The datagrams that hold and set the controls. They are encoded once and sent again with other values.

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
    pub(super) fn take(&mut self, send: &mut dyn FnMut(&[u8])) {
        self.set_overrides(1.0, send);
        for (template, value) in &mut self.hold {
            send(template.with_value(*value));
        }
    }

    /// Releases the controls.
    pub(super) fn release(&mut self, send: &mut dyn FnMut(&[u8])) {
        self.set_overrides(0.0, send);
    }

    fn set_overrides(&mut self, value: f32, send: &mut dyn FnMut(&[u8])) {
        for template in &mut self.overrides {
            send(template.with_value(value));
        }
    }

    /// Sets the controls.
    pub(super) fn set(&mut self, controls: Controls, send: &mut dyn FnMut(&[u8])) {
        send(self.roll.with_value(controls.roll as f32));
        send(self.pitch.with_value(controls.pitch as f32));
        send(self.yaw.with_value(controls.yaw as f32));
        for template in &mut self.collective {
            send(template.with_value(controls.collective as f32));
        }
    }
}
