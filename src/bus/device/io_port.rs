//! What the handles of a device and the bus thread share: the inputs as published, the outputs as set. Only atomics.

use std::{
    cell::RefCell,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU64, Ordering},
    },
    time::Duration,
};

use crate::{
    bus::{
        cycle::{Answer, DriveData, Drives, Stepper},
        device::{
            Device, DeviceKind,
            io_cell::{Cell, Head},
            io_points::{Image, IoPoint},
        },
    },
    coe::DriveId,
    pdo_map::Direction,
};

/// Set in the value of an output once a program has set it.
const SET: u64 = 1 << 32;

/// A device, seen from both sides.
#[derive(Debug)]
pub(in crate::bus) struct Shared {
    pub name: String,
    pub device: DriveId,
    pub points: Vec<IoPoint>,
    pub cell: Cell,
    /// Of each point; those of inputs are never used.
    outputs: Box<[AtomicU64]>,
    changed: AtomicBool,
}

impl Shared {
    fn new(name: &str, device: &DriveId, image: &Image) -> Self {
        Self {
            name: name.to_owned(),
            device: device.clone(),
            points: image.points.clone(),
            cell: Cell::new(image.bytes(Direction::Inputs)),
            outputs: image.points.iter().map(|_| AtomicU64::new(0)).collect(),
            changed: AtomicBool::new(false),
        }
    }

    /// Sets an output, which is in the next frame.
    pub fn set(&self, point: usize, bits: u32) {
        if let Some(output) = self.outputs.get(point) {
            output.store(SET | u64::from(bits), Ordering::Release);
            // Exchanged and not stored: then what other threads have set just before is merged with it.
            self.changed.swap(true, Ordering::Release);
        }
    }

    pub fn was_set(&self, point: usize) -> Option<u32> {
        let value = self.outputs.get(point)?.load(Ordering::Acquire);
        (value & SET != 0).then_some(value as u32)
    }

    /// Nothing is set any more.
    fn forget(&self) {
        for output in &self.outputs {
            output.store(0, Ordering::Release);
        }
    }

    /// Whether there is anything to merge.
    fn is_set(&self) -> bool {
        self.changed.load(Ordering::Relaxed)
    }

    /// Merges what was set into the outputs.
    fn merge(&self, outputs: &mut [u8]) {
        // Before the values are read: what is set from now on is merged the next time.
        self.changed.swap(false, Ordering::AcqRel);
        for (point, value) in self.points.iter().zip(&self.outputs) {
            let value = value.load(Ordering::Acquire);
            if value & SET != 0 {
                point.place.write(outputs, u64::from(value as u32));
            }
        }
    }
}

/// All devices of a network that are no drives, in the cycle.
pub(in crate::bus) struct Ports {
    /// The place of the first one in the exchange; the others follow.
    first: usize,
    ports: Vec<Port>,
    /// All outputs are 0 from now on.
    ended: bool,
}

struct Port {
    shared: Arc<Shared>,
    head: Head,
    /// Its outputs are 0 while it is brought back into OP.
    held: bool,
}

impl Ports {
    /// The ports of those of these devices that are no drives; these stand one behind the other.
    pub fn open(devices: &[Device]) -> Self {
        let ports = devices.iter().filter_map(|device| match &device.kind {
            DeviceKind::Drive(_) => None,
            DeviceKind::Io { name, points } => Some(Port {
                shared: Arc::new(Shared::new(name, &device.found.id, points)),
                head: Head::default(),
                held: false,
            }),
        });
        let is_io = |device: &Device| device.as_drive().is_none();
        Self {
            first: devices.iter().position(is_io).unwrap_or(devices.len()),
            ports: ports.collect(),
            ended: false,
        }
    }

    /// The program's side of each.
    pub fn handles(&self) -> Vec<crate::bus::device::io::Io> {
        let shared = self.ports.iter().map(|port| Arc::clone(&port.shared));
        shared.map(crate::bus::device::io::Io::new).collect()
    }

    /// The outputs of the device at this place of the exchange are 0 until it is back in OP.
    pub fn hold(&mut self, place: usize) {
        if let Some(port) = self.port(place) {
            port.held = true;
        }
    }

    /// The device at this place is back in OP: what is set from now on comes into effect, and nothing from before.
    pub fn release(&mut self, place: usize) {
        if let Some(port) = self.port(place).filter(|port| port.held) {
            port.shared.forget();
            port.held = false;
        }
    }

    fn port(&mut self, place: usize) -> Option<&mut Port> {
        self.ports.get_mut(place.checked_sub(self.first)?)
    }

    /// From now on all outputs are 0.
    pub const fn end(&mut self) {
        self.ended = true;
    }
}

impl Stepper for Rc<RefCell<Ports>> {
    fn before_send(&mut self, _: Duration, drives: &mut Drives) {
        let this = &*self.borrow();
        for (port, place) in this.ports.iter().zip(this.first..) {
            let is_off = this.ended || port.held;
            if !(is_off || port.shared.is_set()) {
                continue;
            }
            let Some(outputs) = drives.outputs_mut(place) else {
                continue;
            };
            if is_off {
                outputs.fill(0);
            } else {
                port.shared.merge(outputs);
            }
        }
    }

    fn after_receive(&mut self, _: Duration, drives: &mut Drives) {
        let this = &mut *self.borrow_mut();
        let ports = this.ports.iter_mut();
        for (port, data) in ports.zip(drives.iter().skip(this.first)) {
            let is_off = this.ended || port.held;
            port.publish(data, is_off);
        }
    }
}

impl Port {
    /// `is_off`: what went out were zeros, whatever is set.
    fn publish(&mut self, data: &DriveData, is_off: bool) {
        let worth = data.worth();
        self.head = Head {
            cycle: self.head.cycle.wrapping_add(1),
            age: match worth {
                Answer::Stale => self.head.age.map(|age| age.saturating_add(1)),
                Answer::Fresh | Answer::Answered => Some(0),
            },
            lost: data.lost,
            operational: data.is_operational(),
            delivered: worth == Answer::Fresh && !is_off,
        };
        self.shared.cell.publish(self.head, &data.inputs);
    }
}

impl Drop for Port {
    /// No more cycles: whatever came is old.
    fn drop(&mut self) {
        let head = Head {
            cycle: self.head.cycle,
            age: self.head.age.map(|_| u32::MAX),
            lost: true,
            ..Head::default()
        };
        self.shared.cell.publish_again(head);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        bus::{
            cycle::frame::{InputMarker, Member},
            device::io::Io,
        },
        pdo_map::{Entry, MappedPdo, Mapping},
        sii::{Identity, Sii},
    };

    /// A terminal with three words of inputs, of which the last lies behind the first eight bytes and one across them.
    fn terminal() -> (Shared, Image) {
        let mut image = vec![0; 0x80];
        image.extend([0xFF, 0xFF]);
        let sii = Sii::parse(&image).unwrap();
        let pdo = MappedPdo {
            index: 0x1A00,
            entries: vec![
                Entry::new(0x6000, 1, 32),
                Entry::new(0x6000, 2, 16),
                Entry::padding(8),
                Entry::new(0x6000, 3, 16),
                Entry::new(0x6000, 4, 32),
            ],
        };
        let image = Image::of_mapping(&Mapping::from_pdos(Vec::new(), vec![pdo]), &sii);
        let device = DriveId {
            position: 0,
            name: String::new(),
            identity: Identity::default(),
        };
        (Shared::new("terminal", &device, &image), image)
    }

    #[test]
    fn what_came_last_is_still_that_once_the_network_has_ended() {
        let (shared, image) = terminal();
        let inputs = image.bytes(Direction::Inputs);
        let mut drives = Drives::new(&[Member {
            logical: 0,
            outputs: 0,
            inputs,
            lrw: true,
            marker: InputMarker::AnyBits,
            patience: 10,
            leaves: false,
        }]);
        let shared = Arc::new(shared);
        let mut port = Port {
            shared: Arc::clone(&shared),
            head: Head::default(),
            held: false,
        };
        let io = Io::new(shared);
        let first = io.input::<u32>((0x6000, 1)).unwrap();
        let across = io.input::<u16>((0x6000, 3)).unwrap();
        let last = io.input::<u32>((0x6000, 4)).unwrap();
        let data = drives.first_mut().unwrap();
        data.answer = Answer::Fresh;
        for value in [0x11, 0x22, 0x33] {
            data.inputs.fill(value);
            port.publish(data, false);
        }
        let values = || {
            let value = |value: Option<u32>| value.unwrap();
            [
                value(first.last().map(|sampled| sampled.value)),
                value(across.last().map(|sampled| sampled.value.into())),
                value(last.last().map(|sampled| sampled.value)),
            ]
        };
        let before = values();
        assert_eq!(before, [0x3333_3333, 0x3333, 0x3333_3333]);
        drop(port);
        assert!(io.status().lost);
        assert_eq!(
            values().map(|value| format!("{value:X}")),
            before.map(|value| format!("{value:X}"))
        );
    }
}
