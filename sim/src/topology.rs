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
        let before = ORDER.into_iter().take_while(|other| *other != port);
        let children = before.filter_map(|port| self.child(to, port));
        let place = children
            .map(|child| self.behind(child))
            .max()
            .unwrap_or(to + 1);
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
        });
    }

    /// Sets how long a frame takes to a device from the one in front of it, in nanoseconds.
    pub(crate) fn set_delay(&mut self, device: usize, delay: u64) {
        if let Some(link) = self.links.get_mut(device) {
            link.delay = delay;
        }
    }

    /// Which devices a frame reaches when only those are passable, and only those ports of a device open.
    pub(crate) fn reached(
        &self,
        passable: impl Fn(usize) -> bool,
        open: impl Fn(usize, usize) -> bool,
    ) -> Vec<bool> {
        let mut reached: Vec<bool> = Vec::with_capacity(self.links.len());
        for (device, link) in self.links.iter().enumerate() {
            let front = link
                .to
                .is_none_or(|(front, port)| reached[front] && open(front, port));
            reached.push(front && passable(device));
        }
        reached
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

    #[test]
    fn behind_a_pulled_cable_nothing_is_reached() {
        let reached = branch().reached(|device| device != 2, |_, _| true);
        assert_eq!(reached, [true, true, false, true]);
        let places = branch().places(&reached, None);
        assert_eq!(places[1].back, [None, Some(1_000), None, None]);
        assert_eq!(
            branch().reached(|device| device != 1, |_, _| true),
            [true, false, false, false]
        );
    }
}
