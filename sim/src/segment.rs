//! A line of SubDevices: frames in, frames out.

use core::time::Duration;

use crate::al::AlState;
use crate::cable::{self, BadCable};
use crate::datagram::execute;
use crate::device::Device;
use crate::ds402::{Axis, Plant};
use crate::frame::{datagrams, is_ethercat, mark_source};
use crate::topology::{Cable, Port, Reach, Topology};

/// One axis after one drive cycle.
#[derive(Clone, Copy, Debug)]
pub struct CycleRecord<'a> {
    /// When the cycle was.
    pub time: Duration,
    /// Number of the drive among the drives of the segment, from zero.
    pub drive: usize,
    /// Number of the axis in the drive, from one.
    pub axis: usize,
    /// AL state of the drive.
    pub al_state: AlState,
    /// The axis.
    pub model: &'a Axis,
}

/// Called after each drive cycle, for each axis.
type Observer = Box<dyn FnMut(&CycleRecord<'_>) + Send>;

/// SubDevices in a line, in the order in which frames reach them.
///
/// ```
/// use core::time::Duration;
/// use servocrab_sim::{Segment, personality};
///
/// let mut segment = Segment::new();
/// segment.push(personality::akd2g());
/// // One BRD of the AL status (0130h, two bytes).
/// let mut frame = vec![0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x10, 0, 0, 0, 0, 1, 0x88, 0xA4, 14, 0x10];
/// frame.extend([7, 0, 0, 0, 0x30, 0x01, 2, 0, 0, 0, 0, 0, 0, 0]);
/// assert!(segment.process(&mut frame, Duration::ZERO));
/// assert_eq!(frame[26..30], [1, 0, 1, 0]); // INIT, and one SubDevice has answered
/// ```
#[derive(Default)]
pub struct Segment {
    devices: Vec<Device>,
    topology: Topology,
    /// Where the last frame got to; the devices' places are set for that.
    reach: Reach,
    /// Where the end of the line is plugged in.
    ring: Option<(usize, usize)>,
    bad_cable: Option<BadCable>,
    observer: Option<Observer>,
    started: bool,
}

impl core::fmt::Debug for Segment {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let names = self.devices.iter().map(|device| &device.description().name);
        f.debug_list().entries(names).finish()
    }
}

impl Segment {
    /// A segment without SubDevices.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Appends a SubDevice at the end of the line.
    pub fn push(&mut self, device: Device) {
        self.topology.append();
        self.devices.push(device);
        self.reach = Reach::default();
        self.started = false;
    }

    /// Plugs a SubDevice into port 1, 2 or 3 of the one at position `to`, as the begin of a branch. Tells its position:
    /// a frame goes through port 3 of a device, then 1, then 2, and the positions behind move up. `None`, and the device
    /// is not in the segment, when the port is taken or not there.
    ///
    /// ```
    /// use servocrab_sim::{Segment, personality};
    ///
    /// let mut segment = Segment::new().with(personality::coupler()).with(personality::akd2g());
    /// assert_eq!(segment.attach(0, 3, personality::sigma7()), Some(1));
    /// assert_eq!(segment.attach(0, 1, personality::sigma7()), None);
    /// ```
    #[must_use]
    pub fn attach(&mut self, to: usize, port: usize, device: Device) -> Option<usize> {
        let position = self.topology.attach(to, port)?;
        self.devices.insert(position, device);
        self.reach = Reach::default();
        self.started = false;
        Some(position)
    }

    /// Sets how long a frame takes to the SubDevice at this position from the one in front of it, either way; 500 ns where
    /// nothing else was said.
    pub fn set_delay(&mut self, position: usize, delay: Duration) {
        let delay = delay.as_nanos().try_into().unwrap_or(u64::MAX / 4);
        self.topology.set_delay(position, delay);
        self.reach = Reach::default();
    }

    /// Appends a SubDevice at the end of the line.
    #[must_use]
    pub fn with(mut self, device: Device) -> Self {
        self.push(device);
        self
    }

    /// Number of SubDevices, with power or without.
    #[must_use]
    pub fn len(&self) -> usize {
        self.devices.len()
    }

    /// Whether there is no SubDevice.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.devices.is_empty()
    }

    /// A SubDevice by its position in the line, from zero.
    #[must_use]
    pub fn device(&self, position: usize) -> Option<&Device> {
        self.devices.get(position)
    }

    /// A SubDevice to be changed, by its position in the line, from zero.
    pub fn device_mut(&mut self, position: usize) -> Option<&mut Device> {
        self.devices.get_mut(position)
    }

    /// All SubDevices in order.
    #[must_use]
    pub fn devices(&self) -> &[Device] {
        &self.devices
    }

    /// An axis by the position of its SubDevice and its number in it, both from zero.
    #[must_use]
    pub fn axis(&self, position: usize, axis: usize) -> Option<&Axis> {
        self.device(position)?.axis(axis)
    }

    /// An axis to be changed.
    pub fn axis_mut(&mut self, position: usize, axis: usize) -> Option<&mut Axis> {
        self.device_mut(position)?.axis_mut(axis)
    }

    /// Hangs a plant on every axis of the segment; each has a seed of its own.
    pub fn set_plant(&mut self, plant: Plant) {
        for (position, device) in (0u64..).zip(&mut self.devices) {
            let seed = plant.seed.wrapping_add(position << 8);
            device.set_plant(plant.with_seed(seed));
        }
    }

    /// The segment with [`Plant::ideal`] on every axis that it has now, for tests of words and figures.
    ///
    /// ```
    /// use servocrab_sim::{Segment, ds402::Plant, personality};
    ///
    /// let segment = Segment::new().with(personality::akd2g()).ideal();
    /// assert_eq!(segment.axis(0, 1).map(|axis| axis.plant().dither), Some(0));
    /// ```
    #[must_use]
    pub fn ideal(mut self) -> Self {
        self.set_plant(Plant::ideal());
        self
    }

    /// The last whole buffer of outputs that reached a SubDevice.
    #[must_use]
    pub fn last_outputs(&self, position: usize) -> &[u8] {
        self.device(position).map_or(&[], Device::last_outputs)
    }

    /// Pulls the cable in front of the SubDevice at this position; zero cuts off the whole segment. Others stay as they are.
    pub fn unplug(&mut self, position: usize) {
        self.set_cable(position, Cable::Out);
    }

    /// Puts the cable in front of the SubDevice at this position back.
    pub fn plug_in(&mut self, position: usize) {
        self.set_cable(position, Cable::In);
    }

    /// Leaves the connector of the cable in front of the SubDevice at this position half in: the ports at both ends show a link, and a
    /// frame that goes out there is lost. The SubDevices that it has reached before have taken it, the others have not. While the port
    /// in front is closed (0101h), frames turn round there and nothing is lost.
    ///
    /// ```
    /// use core::time::Duration;
    /// use servocrab_sim::{Segment, personality};
    ///
    /// let mut segment = Segment::new().with(personality::coupler()).with(personality::akd2g());
    /// let mut frame = vec![0xFF; 12];
    /// frame.extend([0x88, 0xA4, 13, 0x10, 7, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
    /// segment.half_plug(1);
    /// assert!(!segment.process(&mut frame, Duration::ZERO));
    /// segment.plug_in(1);
    /// assert!(segment.process(&mut frame, Duration::ZERO));
    /// ```
    pub fn half_plug(&mut self, position: usize) {
        self.set_cable(position, Cable::Half);
    }

    /// Plugs a cable from the last SubDevice's port 1 into this port of another one, so that the line is a ring.
    pub fn plug_end_into(&mut self, position: usize, port: usize) {
        self.ring = Some((position, port));
        self.reach = Reach::default();
    }

    /// Puts all cables back.
    pub fn plug(&mut self) {
        self.topology.plug_all();
        self.update_links();
    }

    /// Has the cable in front of the SubDevice at this position damage one of so many frames on their way out, so that they
    /// do not come back; none with zero. Those in front of it have taken what was in them for them; those at and behind it
    /// take nothing, and count the damage at their ports.
    pub fn damage_frames(&mut self, position: usize, every: u32) {
        self.bad_cable = BadCable::new(position, every);
    }

    /// Has a function called after each drive cycle, once for each axis.
    pub fn observe(&mut self, observer: impl FnMut(&CycleRecord<'_>) + Send + 'static) {
        self.observer = Some(Box::new(observer));
    }

    /// Takes a frame through all SubDevices and back, in place. `false`, with the frame unchanged, when it is no EtherCAT
    /// frame or when no SubDevice is there to return it; `false` also for a frame that was damaged or lost on its way.
    ///
    /// `now` never goes back from call to call.
    pub fn process(&mut self, frame: &mut [u8], now: Duration) -> bool {
        self.advance(now);
        self.see_who_is_reached();
        let reached = &self.reach.devices;
        if !is_ethercat(frame) || reached.first() != Some(&true) {
            return false;
        }
        let damaged_at = self.bad_cable.as_mut().and_then(BadCable::damages);
        let damaged_at = damaged_at.filter(|at| reached.get(*at) == Some(&true));
        mark_source(frame);
        for range in datagrams(frame) {
            if let Some(datagram) = frame.get_mut(range) {
                let whole = damaged_at.unwrap_or(usize::MAX);
                let devices = self.devices.iter_mut().zip(reached).take(whole);
                for (device, _) in devices.filter(|(_, reached)| **reached) {
                    if execute(device.esc(), datagram, now) {
                        device.after_datagram(now);
                    }
                }
            }
        }
        damaged_at.map_or(self.reach.comes_back, |at| {
            let devices = self.devices.iter_mut().zip(reached);
            cable::count_damage(
                at,
                devices.map(|(device, reached)| (device.esc(), *reached)),
            );
            false
        })
    }

    /// Runs the processors of all SubDevices up to `now`, cycle by cycle.
    pub fn advance(&mut self, now: Duration) {
        if !self.started {
            self.started = true;
            self.devices
                .iter_mut()
                .for_each(|device| device.start_at(now));
        }
        while let Some(time) = self.devices.iter().filter_map(Device::next_event).min()
            && time <= now
        {
            let mut drive = 0;
            for device in &mut self.devices {
                let due = device.next_event().is_some_and(|event| event <= time);
                if due && device.run(time) {
                    observe(&mut self.observer, device, drive, time);
                }
                drive += usize::from(!device.axes().is_empty());
            }
        }
    }

    fn set_cable(&mut self, position: usize, cable: Cable) {
        self.topology.set_cable(position, cable);
        self.update_links();
    }

    /// Tells the SubDevices which of their ports have a link. One that was switched on since the last time was without power before.
    fn update_links(&mut self) {
        let fresh: Vec<bool> = self.devices.iter_mut().map(Device::take_fresh).collect();
        if fresh.contains(&true) {
            self.reach = Reach::default();
            self.set_links(|position| fresh.get(position) != Some(&true));
        }
        self.set_links(|_| true);
    }

    /// Sets the links as they are when only these devices have power, of those that have it.
    fn set_links(&mut self, with_power: impl Fn(usize) -> bool) {
        let powered = |position: usize| {
            let device = self.devices.get(position);
            device.is_some_and(Device::is_powered) && with_power(position)
        };
        let links = self.topology.links(powered, self.ring);
        for (device, links) in self.devices.iter_mut().zip(links) {
            device.set_links(links);
        }
    }

    /// Looks which SubDevices have power, a cable and an open port in front of them.
    fn see_who_is_reached(&mut self) {
        self.update_links();
        let powered = |position| self.device(position).is_some_and(Device::is_powered);
        let port = |position, port| {
            let device = self.device(position);
            device.map_or(Port::Closed, |device| device.port(port))
        };
        let reach = self.topology.reach(powered, port);
        if reach.devices != self.reach.devices {
            let places = self.topology.places(&reach.devices, self.ring);
            let devices = self.devices.iter_mut().zip(places).zip(&reach.devices);
            for ((device, place), _) in devices.filter(|(_, reached)| **reached) {
                device.set_place(place);
            }
        }
        self.reach = reach;
    }
}

fn observe(observer: &mut Option<Observer>, device: &Device, drive: usize, time: Duration) {
    let Some(observer) = observer else {
        return;
    };
    for (axis, model) in (1..).zip(device.axes()) {
        observer(&CycleRecord {
            time,
            drive,
            axis,
            al_state: device.al_state(),
            model,
        });
    }
}
