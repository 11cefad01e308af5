//! The ports: which have a link, and which are open (0101h, 0110h). A port whose loop is closed sends no frame out; its link is another
//! thing.
//! Source: ESC data sheet, section II "Register description", 0100h and 0110h.

use super::{Esc, reg};

/// Link and loop of each port.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Ports {
    links: [bool; 4],
    open: [bool; 4],
}

impl Esc {
    /// Tells the ESC which ports have a link: a cable, and a neighbour with power.
    pub(crate) fn set_links(&mut self, links: [bool; 4]) {
        let before = self.ports.links;
        if before == links {
            return;
        }
        self.ports.links = links;
        for (port, (before, now)) in (0..).zip(before.into_iter().zip(links)) {
            if before && !now {
                self.count_lost_link(port);
            }
        }
        // 0007h: ports 2 and 3 are MII where a cable has been seen.
        let mut kinds = self.byte(reg::PORT_KINDS);
        for (port, link) in links.into_iter().enumerate().skip(2) {
            kinds |= u8::from(link) * (0b11 << (2 * port));
        }
        self.set_byte(reg::PORT_KINDS, kinds);
        self.set_loops(false);
    }

    /// Whether frames go out of this port.
    pub(crate) fn port_is_open(&self, port: usize) -> bool {
        self.ports.open.get(port).copied().unwrap_or(false)
    }

    pub(crate) fn has_link(&self, port: usize) -> bool {
        self.ports.links.get(port).copied().unwrap_or(false)
    }

    /// The MainDevice has written the loop control of all ports.
    pub(super) fn write_loop_control(&mut self, value: u8) {
        self.set_byte(reg::LOOP_CONTROL, value);
        self.set_loops(true);
    }

    /// Opens and closes the ports by their links and their control; `written` says that it was written just now.
    fn set_loops(&mut self, written: bool) {
        let control = self.byte(reg::LOOP_CONTROL);
        let Ports { links, open } = &mut self.ports;
        for (port, (open, link)) in open.iter_mut().zip(*links).enumerate() {
            *open = match control >> (2 * port) & 0x03 {
                0b00 => link,
                // A frame that comes in opens the port, too, and those of the MainDevice come in at port 0.
                0b01 => link && (*open || written || port == 0),
                0b10 => true,
                _ => false,
            };
        }
        self.show_ports();
    }

    /// DL status. Bit 0: SII loaded; bit 1: the processor serves its watchdog. Of each port: link (bits 4 and up), and in pairs from
    /// bit 8: closed, communication.
    pub(super) fn show_ports(&mut self) {
        let Ports { links, open } = self.ports;
        let mut status = u16::from(self.sii_loaded) | self.word(reg::DL_STATUS) & 0x0002;
        for (port, (link, open)) in links.into_iter().zip(open).enumerate() {
            status |= u16::from(link) << (4 + port);
            status |= u16::from(!open) << (8 + 2 * port);
            status |= u16::from(link && open) << (9 + 2 * port);
        }
        self.set_word(reg::DL_STATUS, status);
    }
}
