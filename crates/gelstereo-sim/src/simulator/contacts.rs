//! Contacts of all parts at one moment.

use super::Simulator;
use crate::simulator::ContactState;
use alloc::vec::Vec;

impl Simulator {
    /// Sets the contacts of a moment: of the indenter as given, and of the others by their trajectories.
    pub(super) fn pose(&mut self, contact: Option<&ContactState>, frame: u64) {
        let mut contacts = core::mem::take(&mut self.scratch.contacts);
        self.plan_contacts(self.time_s(frame), &mut contacts);
        if let Some(first) = contacts.first_mut() {
            *first = contact.filter(|contact| contact.validate().is_ok()).copied();
        }
        self.scratch.contacts = contacts;
    }

    /// Sets the contacts of a moment.
    pub(super) fn pose_all(&mut self, given: &[Option<ContactState>]) {
        let valid = |part: usize| given.get(part).copied().flatten().filter(|c| c.validate().is_ok());
        self.scratch.contacts.clear();
        self.scratch.contacts.extend((0..self.parts.len()).map(valid));
    }

    /// Contacts on the trajectories at a time.
    pub(super) fn plan_contacts(&self, time_s: f64, out: &mut Vec<Option<ContactState>>) {
        out.clear();
        out.extend((0..self.parts.len()).map(|part| self.trajectory.contact(part, time_s)));
    }
}
