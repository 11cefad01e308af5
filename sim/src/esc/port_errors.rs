//! The error counters of the ports: RX errors 0300h to 0307h, forwarded RX errors 0308h to 030Bh, lost links 0310h to 0313h.
//! Source: ESC data sheet, section II, "Error counters".

use super::{Esc, reg};

/// Port 0's, then port 1's and so on: invalid frames, RX errors.
const RX_ERRORS: u16 = 0x0300;
const FORWARDED: u16 = 0x0308;
const LOST_LINKS: u16 = 0x0310;

impl Esc {
    /// A frame with a wrong checksum has come in at this port; `marked` where a device before has found that out.
    pub(crate) fn count_damaged_frame(&mut self, port: u16, marked: bool) {
        if marked {
            self.count(FORWARDED + port);
        } else {
            self.count(RX_ERRORS + 2 * port);
            self.count(RX_ERRORS + 2 * port + 1);
        }
    }

    /// A port that had a link has none any more.
    pub(super) fn count_lost_link(&mut self, port: u16) {
        self.count(LOST_LINKS + port);
    }

    /// The counters stop at 255.
    fn count(&mut self, register: u16) {
        debug_assert!(register < reg::WATCHDOG_DIVIDER);
        self.set_byte(register, self.byte(register).saturating_add(1));
    }
}
