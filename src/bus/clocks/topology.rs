//! Which SubDevice hangs on which port of which other, from the ports that are open.
//! Source: ESC data sheet, section I "Technology": a frame that comes in at port 0 goes through ports 3, 1 and 2, as far as
//! they are open; register 0110h.

use crate::bus::error::TopologyError;

/// The ports of a SubDevice, as its DL status shows them.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Ports(u16);

/// The port of another SubDevice that one hangs on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Upstream {
    pub device: usize,
    pub port: usize,
}

impl Ports {
    /// From register 0110h.
    pub const fn from_dl_status(status: u16) -> Self {
        Self(status)
    }

    /// Whether frames leave and come back by this port: its loop is open, and there is communication.
    pub const fn is_open(self, port: usize) -> bool {
        let (closed, communication) = (8 + 2 * port, 9 + 2 * port);
        self.0 >> closed & 1 == 0 && self.0 >> communication & 1 == 1
    }

    /// The open ports behind port 0, in the order of the frame.
    pub fn downstream(self) -> impl DoubleEndedIterator<Item = usize> {
        in_order()
            .into_iter()
            .filter(move |port| self.is_open(*port))
    }

    /// The open port before this one on the frame's way.
    pub fn before(self, port: usize) -> usize {
        let ports = self.downstream().take_while(|other| *other != port);
        ports.last().unwrap_or(0)
    }

    /// The last port from which the frame comes back; 0 where there is none behind.
    pub fn last(self) -> usize {
        self.downstream().next_back().unwrap_or(0)
    }
}

/// The ports behind port 0, in the order in which a frame leaves a SubDevice by them.
const fn in_order() -> [usize; 3] {
    [3, 1, 2]
}

/// What each SubDevice hangs on; nothing for the first.
fn upstream(line: &[Ports]) -> Result<Vec<Option<Upstream>>, TopologyError> {
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

// Propagation delays and offsets of distributed clocks, from the receive times that one frame has latched.
// Source: ESC data sheet, section I "Technology", 9.1.2 and 9.1.3. What a frame takes longer through the processing unit
// than past it (some tens of nanoseconds, which only the maker states) is left out.

/// How wide a distributed clock is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) enum Width {
    Bits32,
    Bits64,
}

/// What a SubDevice shows after the latch.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Latched {
    pub ports: Ports,
    /// Its clock, where it has one.
    pub clock: Option<LatchedClock>,
}

/// What a clock latched.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct LatchedClock {
    pub width: Width,
    /// Registers 0900h to 090Fh.
    pub received: [u32; 4],
    /// Register 0918h; a clock of 32 bits has the lower half alone.
    pub local: u64,
}

impl LatchedClock {
    /// Nanoseconds from the frame's passing of one port to that of another. The registers begin again every 4.3 s.
    fn between(&self, from: usize, to: usize) -> u32 {
        let time = |port: usize| self.received.get(port).copied().unwrap_or(0);
        time(to).wrapping_sub(time(from))
    }
}

/// The settings of a clock: registers 0928h and 0920h.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::bus) struct Setting {
    /// Nanoseconds that a frame takes from the reference clock to this one.
    pub delay: u32,
    /// What is added to the local time.
    pub offset: u64,
}

/// The settings of a line's clocks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::bus) struct Settings {
    /// The position of the reference clock: the first one.
    pub reference: usize,
    /// What each clock is to be set to, so that all show the reference's local time.
    pub of_each: Vec<Option<Setting>>,
}

/// The settings of a line's clocks; `None` if there is none.
pub(in crate::bus) fn settings(line: &[Latched]) -> Result<Option<Settings>, TopologyError> {
    let Some((reference, first)) = (0..)
        .zip(line)
        .find_map(|(position, latched)| Some((position, latched.clock?)))
    else {
        return Ok(None);
    };
    let settings = delays(line)?.into_iter().zip(line).map(|(delay, latched)| {
        let (delay, clock) = (delay?, latched.clock?);
        let offset = first
            .local
            .wrapping_add(delay.into())
            .wrapping_sub(clock.local);
        Some(Setting { delay, offset })
    });
    Ok(Some(Settings {
        reference,
        of_each: settings.collect(),
    }))
}

/// The delay from the reference clock to each clock.
fn delays(line: &[Latched]) -> Result<Vec<Option<u32>>, TopologyError> {
    let ports: Vec<_> = line.iter().map(|latched| latched.ports).collect();
    let upstream = upstream(&ports)?;
    let mut delays: Vec<Option<u32>> = Vec::with_capacity(line.len());
    let mut has_reference = false;
    for (position, latched) in line.iter().enumerate() {
        let Some(clock) = latched.clock else {
            if latched.ports.downstream().count() > 1 {
                return Err(TopologyError::BranchWithoutClock { position });
            }
            delays.push(None);
            continue;
        };
        if let Some(port) = entered_before_port_0(latched.ports, &clock) {
            return Err(TopologyError::WrongEntry { position, port });
        }
        let delay = match nearest(line, &upstream, position) {
            None if has_reference => return Err(TopologyError::NoWay { position }),
            None => 0,
            Some(up) => {
                let of_front = delays.get(up.device).copied().flatten().unwrap_or(0);
                let way = line
                    .get(up.device)
                    .map_or(0, |front| way_from(front, up.port, latched.ports, &clock));
                of_front.wrapping_add(way)
            }
        };
        has_reference = true;
        delays.push(Some(delay));
    }
    Ok(delays)
}

/// From port 0 of a SubDevice to port 0 of the clock that hangs on this port of it, and has these ports.
fn way_from(front: &Latched, port: usize, ports: Ports, clock: &LatchedClock) -> u32 {
    let Some(of_front) = front.clock else {
        return 0;
    };
    let before = front.ports.before(port);
    // What the frame spends behind the ports before this one, then behind this one, of which a part is behind the clock.
    let earlier = of_front.between(0, before);
    let behind_port = of_front.between(before, port);
    let behind_clock = clock.between(0, ports.last());
    earlier.wrapping_add(behind_port.saturating_sub(behind_clock) / 2)
}

/// The port of the nearest SubDevice with a clock in front of this one: those without a clock count as a part of the cable.
fn nearest(line: &[Latched], upstream: &[Option<Upstream>], position: usize) -> Option<Upstream> {
    let mut at = position;
    loop {
        let up = (*upstream.get(at)?)?;
        if line.get(up.device)?.clock.is_some() {
            return Some(up);
        }
        at = up.device;
    }
}

/// The port by which frames come in before port 0, if there is one.
fn entered_before_port_0(ports: Ports, clock: &LatchedClock) -> Option<usize> {
    let earlier = |port: &usize| clock.between(0, *port).cast_signed() < 0;
    ports.downstream().find(earlier)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A DL status with port 0 and these ports open.
    pub(in crate::bus::clocks) fn open(ports: &[usize]) -> Ports {
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

#[cfg(test)]
mod delay_tests {
    use super::tests::open;
    use super::*;

    /// A clock of 64 bits with a local time of its own, and when the frame came back to these ports after port 0.
    fn latched(local: u64, back: &[(usize, u32)]) -> Latched {
        let mut received = [0; 4];
        received[0] = local as u32;
        for (port, after) in back {
            received[*port] = (local as u32).wrapping_add(*after);
        }
        let ports: Vec<_> = back.iter().map(|(port, _)| *port).collect();
        Latched {
            ports: open(&ports),
            clock: Some(LatchedClock {
                width: Width::Bits64,
                received,
                local,
            }),
        }
    }

    fn without_clock(ports: &[usize]) -> Latched {
        Latched {
            ports: open(ports),
            clock: None,
        }
    }

    fn delays_of(line: &[Latched]) -> Vec<Option<u32>> {
        delays(line).unwrap()
    }

    #[test]
    fn the_data_sheets_line_with_a_branch_has_its_delays() {
        // Golden: the example of the ESC data sheet, section I, 9.1.2, worked by hand. A - B, C - D on port 1 of B, E - F on its
        // port 2; ways of a frame in nanoseconds AB 300, BC 200, CD 150, BE 400, EF 250.
        let line = [
            // Back at A after 2 (AB + BC + CD + BE + EF).
            latched(1_000_000, &[(1, 2_600)]),
            // Back at B's port 1 after 2 (BC + CD), at port 2 after 2 (BE + EF) more.
            latched(5_000, &[(1, 700), (2, 2_000)]),
            latched(7_000_000, &[(1, 300)]),
            latched(90, &[]),
            latched(0xFFFF_FFF0, &[(1, 500)]),
            latched(123_456, &[]),
        ];
        // Of E: AB + BC + CD + DC + CB + BE.
        let expected = [0, 300, 500, 650, 1_400, 1_650];
        assert_eq!(delays_of(&line), expected.map(Some));
    }

    #[test]
    fn a_branch_at_port_3_comes_before_port_1() {
        // A; B at its port 3, 400 ns away, with C behind it at 100 ns; D at port 1 of A, 250 ns away.
        let line = [
            latched(10, &[(3, 1_000), (1, 1_500)]),
            latched(20, &[(1, 200)]),
            latched(30, &[]),
            latched(40, &[]),
        ];
        assert_eq!(delays_of(&line), [0, 400, 500, 1_250].map(Some));
    }

    #[test]
    fn a_line_of_three_has_half_of_each_loop() {
        // Ways of 520 and 480 ns.
        let line = [
            latched(1_000, &[(1, 2_000)]),
            latched(2_000, &[(1, 960)]),
            latched(3_000, &[]),
        ];
        assert_eq!(delays_of(&line), [0, 520, 1_000].map(Some));
    }

    #[test]
    fn devices_without_a_clock_are_a_part_of_the_cable() {
        let line = [
            without_clock(&[1]),
            latched(1_000, &[(1, 3_000)]),
            without_clock(&[1]),
            latched(5_000, &[(1, 1_000)]),
            without_clock(&[]),
        ];
        assert_eq!(delays_of(&line), [None, Some(0), None, Some(1_000), None]);
        assert_eq!(settings(&line).unwrap().unwrap().reference, 1);
        assert_eq!(settings(&[without_clock(&[])]), Ok(None));
    }

    #[test]
    fn with_their_offsets_all_show_the_references_time_when_the_frame_passes() {
        let line = [
            latched(1_000_000, &[(1, 2_000)]),
            latched(7_000_000_000_000, &[(1, 960)]),
            latched(3_000, &[]),
        ];
        let settings = settings(&line).unwrap().unwrap();
        for (latched, setting) in line.iter().zip(settings.of_each) {
            let (clock, setting) = (latched.clock.unwrap(), setting.unwrap());
            let shown = clock.local.wrapping_add(setting.offset);
            assert_eq!(shown, 1_000_000 + u64::from(setting.delay));
        }
    }

    #[test]
    fn swapped_cables_and_branches_without_a_clock_are_refused_by_name() {
        let mut swapped = latched(1_000, &[(1, 0)]);
        swapped.clock.as_mut().unwrap().received = [1_500, 1_000, 0, 0];
        assert_eq!(
            delays(&[latched(0, &[(1, 900)]), swapped, latched(0, &[])]),
            Err(TopologyError::WrongEntry {
                position: 1,
                port: 1
            })
        );
        let branch = [
            latched(0, &[(1, 900)]),
            without_clock(&[3, 1]),
            latched(0, &[]),
            latched(0, &[]),
        ];
        assert_eq!(
            delays(&branch),
            Err(TopologyError::BranchWithoutClock { position: 1 })
        );
    }
}
