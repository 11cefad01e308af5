//! How the SubDevices of a segment are wired: a tree of ports, and how long a frame takes from one to the next.
//! Source: ESC data sheet, section I "Technology", 3.2: a frame that comes in at port 0 goes to port 3, then 1, then 2, as
//! far as these are open, and out of port 0 again.

use crate::esc::Place;

/// The order in which a frame leaves the ports of a device, behind port 0.
const ORDER: [usize; 3] = [3, 1, 2];
/// From port to port, in nanoseconds, where nothing else was said: a port and 10 m of cable take about this long.
const HOP_NS: u64 = 500;

/// How one device is connected.
#[derive(Clone, Copy, Debug)]
struct Link {
    /// The device in front of it, and that device's port; `None` for the first.
    to: Option<(usize, usize)>,
    /// From port to port, either way.
    delay: u64,
    cable: Cable,
}

/// The cable in front of a device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Cable {
    #[default]
    In,
    /// Its connector is half in: there is a link, and no frame gets through.
    Half,
    Out,
}

/// Whether frames go out of a port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Port {
    Closed,
    Open,
    OpenWithoutLink,
}

/// Where a frame gets to.
#[derive(Clone, Debug, Default)]
pub(crate) struct Reach {
    /// Which devices it reaches.
    pub(crate) devices: Vec<bool>,
    /// It is not lost on its way.
    pub(crate) comes_back: bool,
}

/// The wiring; devices are numbered in the order in which frames reach them.
#[derive(Clone, Debug, Default)]
pub(crate) struct Topology {
    links: Vec<Link>,
}

impl Topology {
    /// Where a new device gets its place when it is plugged into this port; `None` when the port is not free or not there.
    pub(crate) fn attach(&mut self, to: usize, port: usize) -> Option<usize> {
        let taken = |port| self.child(to, port).is_some();
        if to >= self.links.len() || !ORDER.contains(&port) || taken(port) {
            return None;
        }
        let place = self.first_behind(to, port);
        for link in &mut self.links {
            if let Some((device, _)) = &mut link.to
                && *device >= place
            {
                *device += 1;
            }
        }
        let link = Link {
            to: Some((to, port)),
            delay: HOP_NS,
            cable: Cable::In,
        };
        self.links.insert(place, link);
        Some(place)
    }

    /// Plugs a new device behind the last one, at its port 1.
    pub(crate) fn append(&mut self) {
        let last = self.links.len().checked_sub(1);
        self.links.push(Link {
            to: last.map(|last| (last, 1)),
            delay: last.map_or(0, |_| HOP_NS),
            cable: Cable::In,
        });
    }

    /// Sets how long a frame takes to a device from the one in front of it, in nanoseconds.
    pub(crate) fn set_delay(&mut self, device: usize, delay: u64) {
        if let Some(link) = self.links.get_mut(device) {
            link.delay = delay;
        }
    }

    /// Changes the cable in front of a device.
    pub(crate) fn set_cable(&mut self, device: usize, cable: Cable) {
        if let Some(link) = self.links.get_mut(device) {
            link.cable = cable;
        }
    }

    /// Puts all cables back.
    pub(crate) fn plug_all(&mut self) {
        for link in &mut self.links {
            link.cable = Cable::In;
        }
    }

    /// Which ports of each device have a link, when these have power; `ring` is a device's port to which the last one is plugged.
    pub(crate) fn links(
        &self,
        powered: impl Fn(usize) -> bool,
        ring: Option<(usize, usize)>,
    ) -> Vec<[bool; 4]> {
        let mut links = vec![[false; 4]; self.links.len()];
        let last = self.links.len().saturating_sub(1);
        let cables = self.links.iter().enumerate();
        let plugged = cables.filter(|(_, link)| link.cable != Cable::Out);
        let wires = plugged.map(|(device, link)| ((device, 0), link.to));
        for (one, other) in wires.chain(ring.map(|port| ((last, 1), Some(port)))) {
            let ends = core::iter::once(one).chain(other);
            if ends.clone().all(|(device, _)| powered(device)) {
                for (device, port) in ends {
                    if let Some(link) = links.get_mut(device).and_then(|all| all.get_mut(port)) {
                        *link = true;
                    }
                }
            }
        }
        links
    }

    /// Where a frame gets to when only these devices have power and their ports are in these states. One that goes out of a port
    /// without a link, or into a connector that is half in, is lost there: it has been at the devices in front of that port.
    pub(crate) fn reach(
        &self,
        powered: impl Fn(usize) -> bool,
        port: impl Fn(usize, usize) -> Port,
    ) -> Reach {
        let mut devices: Vec<bool> = Vec::with_capacity(self.links.len());
        let mut lost_at = usize::MAX;
        for (device, link) in self.links.iter().enumerate() {
            let goes_there = link.to.is_none_or(|(front, number)| {
                devices.get(front) == Some(&true) && port(front, number) == Port::Open
            });
            if goes_there && link.cable == Cable::Half {
                lost_at = lost_at.min(device);
            }
            let reached = goes_there && link.cable == Cable::In && powered(device);
            devices.push(reached);
            for number in ORDER {
                if reached && port(device, number) == Port::OpenWithoutLink {
                    lost_at = lost_at.min(self.first_behind(device, number));
                }
            }
        }
        devices
            .iter_mut()
            .skip(lost_at)
            .for_each(|reached| *reached = false);
        Reach {
            devices,
            comes_back: lost_at == usize::MAX,
        }
    }

    /// The place of each device while a frame reaches those; `ring` is a device's port to which the last one is plugged.
    pub(crate) fn places(&self, reached: &[bool], ring: Option<(usize, usize)>) -> Vec<Place> {
        let mut places = vec![Place::default(); self.links.len()];
        if reached.first() == Some(&true) {
            let arrival = self.links.first().map_or(0, |link| link.delay);
            self.pass(0, arrival, reached, &mut places);
        }
        if let Some((to, port)) = ring {
            let last = places.len().saturating_sub(1);
            for (device, port) in [(last, 1), (to, port)] {
                // No frame of the MainDevice comes in there: it goes by that cable once and leaves the ring.
                if let Some(back) = places
                    .get_mut(device)
                    .and_then(|place| place.back.get_mut(port))
                {
                    *back = Some(HOP_NS);
                }
            }
        }
        places
    }

    /// Takes a frame through a device and all behind it; when it comes back to port 0 of the device.
    fn pass(&self, device: usize, arrival: u64, reached: &[bool], places: &mut [Place]) -> u64 {
        let mut now = arrival;
        let mut place = Place {
            arrival,
            ..Place::default()
        };
        for port in ORDER {
            let child = self.child(device, port);
            if let Some(child) = child.filter(|child| reached.get(*child) == Some(&true)) {
                let delay = self.links.get(child).map_or(0, |link| link.delay);
                now = self.pass(child, now + delay, reached, places) + delay;
                place.back[port] = Some(now - arrival);
            }
        }
        if let Some(known) = places.get_mut(device) {
            *known = place;
        }
        now
    }

    fn child(&self, device: usize, port: usize) -> Option<usize> {
        self.links
            .iter()
            .position(|link| link.to == Some((device, port)))
    }

    /// The device that is plugged into this port, or would be.
    fn first_behind(&self, device: usize, port: usize) -> usize {
        let before = ORDER.into_iter().take_while(|other| *other != port);
        let children = before.filter_map(|port| self.child(device, port));
        children
            .map(|child| self.behind(child))
            .max()
            .unwrap_or(device + 1)
    }

    /// The first device that is not behind this one.
    fn behind(&self, device: usize) -> usize {
        let later = self.links.iter().enumerate().skip(device + 1);
        later
            .into_iter()
            .find(|(_, link)| link.to.is_none_or(|(front, _)| front < device))
            .map_or(self.links.len(), |(other, _)| other)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A line of three, and a device at port 3 of the second.
    fn branch() -> Topology {
        let mut topology = Topology::default();
        (0..3).for_each(|_| topology.append());
        assert_eq!(topology.attach(1, 3), Some(2));
        topology
    }

    #[test]
    fn port_3_comes_before_port_1_and_port_2_after_it() {
        let mut topology = branch();
        let front =
            |topology: &Topology| -> Vec<_> { topology.links.iter().map(|link| link.to).collect() };
        let expected = [None, Some((0, 1)), Some((1, 3)), Some((1, 1))];
        assert_eq!(front(&topology), expected);
        assert_eq!(topology.attach(0, 2), Some(4));
        assert_eq!(topology.attach(2, 1), Some(3));
        assert_eq!(front(&topology)[4..], [Some((1, 1)), Some((0, 2))]);
    }

    #[test]
    fn a_port_that_is_taken_or_not_there_takes_nothing() {
        let mut topology = branch();
        assert_eq!(topology.attach(1, 3), None);
        assert_eq!(topology.attach(0, 1), None);
        assert_eq!(topology.attach(0, 0), None);
        assert_eq!(topology.attach(0, 4), None);
        assert_eq!(topology.attach(9, 1), None);
    }

    #[test]
    fn a_frame_goes_through_the_branch_and_then_on() {
        let mut topology = branch();
        topology.set_delay(2, 1_000);
        let places = topology.places(&[true; 4], None);
        let arrivals: Vec<_> = places.iter().map(|place| place.arrival).collect();
        assert_eq!(arrivals, [0, 500, 1_500, 3_000]);
        assert_eq!(places[1].back, [None, Some(3_000), None, Some(2_000)]);
        assert_eq!(places[0].back, [None, Some(4_000), None, None]);
    }

    /// Where a frame gets to while all have power, with ports that open by their links, but for this one.
    fn reach(topology: &Topology, other: (usize, usize), state: Port) -> Reach {
        let links = topology.links(|_| true, None);
        topology.reach(
            |_| true,
            |device, port| match links[device][port] {
                _ if (device, port) == other => state,
                true => Port::Open,
                false => Port::Closed,
            },
        )
    }

    const NONE: (usize, usize) = (9, 9);

    #[test]
    fn behind_a_pulled_cable_nothing_is_reached() {
        let mut topology = branch();
        topology.set_cable(2, Cable::Out);
        let reached = reach(&topology, NONE, Port::Closed);
        assert_eq!(reached.devices, [true, true, false, true]);
        assert!(reached.comes_back);
        let places = topology.places(&reached.devices, None);
        assert_eq!(places[1].back, [None, Some(1_000), None, None]);
        topology.set_cable(1, Cable::Out);
        let reached = reach(&topology, NONE, Port::Closed);
        assert_eq!(reached.devices, [true, false, false, false]);
    }

    /// The second has devices at its ports 3, 1 and 2, which frames reach in this order.
    #[test]
    fn a_frame_that_is_lost_in_a_tree_has_been_at_the_devices_before_that_port() {
        let mut topology = branch();
        assert_eq!(topology.attach(1, 2), Some(4));
        for (half, reached) in [
            (2, [true, true, false, false, false]),
            (3, [true, true, true, false, false]),
            (4, [true, true, true, true, false]),
        ] {
            topology.set_cable(half, Cable::Half);
            let lost = reach(&topology, NONE, Port::Closed);
            assert_eq!((lost.devices, lost.comes_back), (reached.into(), false));
            topology.plug_all();
        }
        // Port 1 of the device at port 3, at which there is nothing.
        let lost = reach(&topology, (2, 1), Port::OpenWithoutLink);
        assert_eq!(lost.devices, [true, true, true, false, false]);
        assert!(!lost.comes_back);
        topology.set_cable(3, Cable::Half);
        let whole = reach(&topology, (1, 1), Port::Closed);
        assert_eq!(whole.devices, [true, true, true, false, true]);
        assert!(whole.comes_back);
    }

    #[test]
    fn a_link_needs_a_cable_and_power_at_both_ends() {
        let mut topology = branch();
        let links = topology.links(|device| device != 3, Some((0, 2)));
        let second = [true, false, false, true];
        assert_eq!(links[..2], [[true, true, false, false], second]);
        assert_eq!(links[3], [false; 4]);
        topology.set_cable(2, Cable::Half);
        assert!(topology.links(|_| true, None)[1][3]);
        topology.set_cable(2, Cable::Out);
        let links = topology.links(|_| true, Some((0, 2)));
        assert_eq!(links[0], [true, true, true, false]);
        assert_eq!((links[1][3], links[2][0]), (false, false));
        assert_eq!(links[3], [true, true, false, false]);
    }
}
