//! Which SubDevice hangs on which port of which other, from the ports that are open.
//! Source: ESC data sheet, section I "Technology": a frame that comes in at port 0 goes through ports 3, 1 and 2, as far as
//! they are open; register 0110h.

/// The order in which a frame leaves the ports of a SubDevice, behind port 0.
const ORDER: [usize; 3] = [3, 1, 2];

/// The ports of a SubDevice, as its DL status shows them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Ports(u16);

/// The port of another SubDevice that one hangs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Upstream {
    pub(in crate::bus) device: usize,
    pub(in crate::bus) port: usize,
}

/// Why the wiring cannot be told. Positions count from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum TopologyError {
    /// Nothing is plugged into a port 0.
    #[error(
        "the SubDevice at position {position} is not connected by its port 0: are its IN and OUT cables swapped?"
    )]
    EntryClosed {
        /// The SubDevice.
        position: usize,
    },
    /// Another port than 0 gets the frames first.
    #[error(
        "frames reach the SubDevice at position {position} by port {port} before port 0: are its IN and OUT cables swapped?"
    )]
    WrongEntry {
        /// The SubDevice.
        position: usize,
        /// The port that gets them first.
        port: usize,
    },
    /// A port is open, but no SubDevice answers behind it.
    #[error(
        "port {port} of the SubDevice at position {position} is open, but nothing answers behind it"
    )]
    NobodyBehind {
        /// The SubDevice.
        position: usize,
        /// Its port.
        port: usize,
    },
    /// No open port is left for a SubDevice.
    #[error("the SubDevice at position {position} answers, but no open port leads to it")]
    NoWay {
        /// The SubDevice.
        position: usize,
    },
    /// A branch begins at a SubDevice that has no receive times, so that the way through it cannot be measured.
    #[error(
        "a branch begins at the SubDevice at position {position}, which has no distributed clock: the delays behind it cannot be \
         measured"
    )]
    BranchWithoutClock {
        /// The SubDevice.
        position: usize,
    },
}

impl Ports {
    /// From register 0110h.
    pub(in crate::bus) const fn from_dl_status(status: u16) -> Self {
        Self(status)
    }

    /// Whether frames leave and come back by this port: its loop is open, and there is communication.
    pub(in crate::bus) const fn is_open(self, port: usize) -> bool {
        let (closed, communication) = (8 + 2 * port, 9 + 2 * port);
        self.0 >> closed & 1 == 0 && self.0 >> communication & 1 == 1
    }

    /// The open ports behind port 0, in the order of the frame.
    pub(in crate::bus) fn downstream(self) -> impl DoubleEndedIterator<Item = usize> {
        ORDER.into_iter().filter(move |port| self.is_open(*port))
    }

    /// The open port before this one on the frame's way.
    pub(in crate::bus) fn before(self, port: usize) -> usize {
        let ports = self.downstream().take_while(|other| *other != port);
        ports.last().unwrap_or(0)
    }

    /// The last port from which the frame comes back; 0 where there is none behind.
    pub(in crate::bus) fn last(self) -> usize {
        self.downstream().next_back().unwrap_or(0)
    }
}

/// What each SubDevice hangs on; nothing for the first.
pub(in crate::bus) fn upstream(line: &[Ports]) -> Result<Vec<Option<Upstream>>, TopologyError> {
    // Open ports on the way back to the MainDevice that nobody has been found behind yet, the next one last.
    let mut waiting: Vec<Upstream> = Vec::new();
    let mut found = Vec::with_capacity(line.len());
    for (position, ports) in line.iter().enumerate() {
        if !ports.is_open(0) {
            return Err(TopologyError::EntryClosed { position });
        }
        let upstream = waiting.pop();
        if upstream.is_none() && position != 0 {
            return Err(TopologyError::NoWay { position });
        }
        found.push(upstream);
        let ports = ports.downstream().rev();
        waiting.extend(ports.map(|port| Upstream {
            device: position,
            port,
        }));
    }
    match waiting.pop() {
        None => Ok(found),
        Some(Upstream { device, port }) => Err(TopologyError::NobodyBehind {
            position: device,
            port,
        }),
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A DL status with port 0 and these ports open.
    pub(in crate::bus::dc) fn open(ports: &[usize]) -> Ports {
        let mut status = 0x5555 & 0xFF00;
        for port in ports.iter().chain(&[0]) {
            status &= !(0x0100 << (2 * port));
            status |= 0x0200 << (2 * port);
        }
        Ports::from_dl_status(status)
    }

    fn hangs_on(line: &[Ports]) -> Vec<Option<(usize, usize)>> {
        let found = upstream(line).unwrap();
        let pairs = found.iter().map(|up| up.map(|up| (up.device, up.port)));
        pairs.collect()
    }

    #[test]
    fn the_dl_status_of_a_real_line_shows_its_open_ports() {
        // Golden: links at ports 0 and 1, loops 2 and 3 closed; the last of a line has port 1 closed too.
        let middle = Ports::from_dl_status(0x5A31);
        assert_eq!(middle.downstream().collect::<Vec<_>>(), [1]);
        let last = Ports::from_dl_status(0x5611);
        assert!(last.is_open(0));
        assert_eq!(last.downstream().count(), 0);
    }

    #[test]
    fn a_line_hangs_on_ports_1() {
        let line = [open(&[1]), open(&[1]), open(&[])];
        assert_eq!(hangs_on(&line), [None, Some((0, 1)), Some((1, 1))]);
    }

    #[test]
    fn port_3_is_before_port_1_and_port_2_behind_it() {
        let line = [
            open(&[1, 2, 3]),
            open(&[1]),
            open(&[]),
            open(&[]),
            open(&[]),
        ];
        let expected = [None, Some((0, 3)), Some((1, 1)), Some((0, 1)), Some((0, 2))];
        assert_eq!(hangs_on(&line), expected);
    }

    #[test]
    fn a_wiring_that_cannot_be_names_the_device() {
        assert_eq!(
            upstream(&[open(&[1]), open(&[1])]),
            Err(TopologyError::NobodyBehind {
                position: 1,
                port: 1
            })
        );
        assert_eq!(
            upstream(&[open(&[]), open(&[])]),
            Err(TopologyError::NoWay { position: 1 })
        );
        // Only port 1 is open.
        let swapped = Ports::from_dl_status(0x5900);
        assert_eq!(
            upstream(&[open(&[1]), swapped]),
            Err(TopologyError::EntryClosed { position: 1 })
        );
    }
}
