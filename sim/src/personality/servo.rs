//! The builder of every drive here. What one drive is made of is a [`Model`]; what a test changes of it, the builder's
//! methods.

use crate::description::{
    ClockDemand, ClockMode, ClockWidth, Description, Direction, Identity, Mailbox, PdoDescription,
    PdoEntryDescription, SyncManagerDescription, SyncManagerUse,
};
use crate::device::{Blueprint, Device};
use crate::drive::{AxisStatusObject, DriveBlueprint, PlainObject};
use crate::ds402::{Axis, Behaviour, DataType, Plant};
use crate::pdo::PdoLimits;

/// What is added to a profile object's index for each further axis (DSP 402 v2: 800h).
const AXIS_INCREMENT: u16 = 0x0800;

/// A PDO of the first axis.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pdo {
    /// 16xxh or 1Axxh.
    pub(super) index: u16,
    /// The objects in it, by index; all have subindex 0.
    pub(super) objects: &'static [u16],
    /// It is assigned at power-up.
    pub(super) assigned: bool,
}

/// What most drives here take of Profile Position in one RxPDO, and what they tell in one TxPDO.
pub(super) const OUTPUTS: &[u16] = &[0x6040, 0x6060, 0x607A, 0x6081, 0x6083, 0x6084];
pub(super) const INPUTS: &[u16] = &[0x6041, 0x6061, 0x6064, 0x606C];

impl Pdo {
    pub(super) const fn assigned(index: u16, objects: &'static [u16]) -> Self {
        Self {
            index,
            objects,
            assigned: true,
        }
    }

    pub(super) const fn offered(index: u16, objects: &'static [u16]) -> Self {
        Self {
            index,
            objects,
            assigned: false,
        }
    }
}

/// Process data memory: address and control byte of its sync manager.
#[derive(Clone, Copy, Debug)]
pub(super) struct Memory {
    pub(super) start: u16,
    pub(super) control: u8,
}

/// One kind of drive, as data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Model {
    pub(super) name: &'static str,
    pub(super) order: &'static str,
    pub(super) identity: Identity,
    /// 1000h.
    pub(super) device_type: u32,
    pub(super) axes: usize,
    pub(super) behaviour: fn() -> Behaviour,
    /// Both mailboxes: address, the other's address, length of each.
    pub(super) mailbox: (u16, u16, u16),
    /// Protocols (word 1Ch of the SII) and the CoE details of category 30.
    pub(super) protocols: u16,
    pub(super) coe_details: u8,
    pub(super) outputs: Memory,
    pub(super) inputs: Memory,
    pub(super) rx_pdos: &'static [Pdo],
    pub(super) tx_pdos: &'static [Pdo],
    /// What is added to a PDO's index for each further axis.
    pub(super) pdo_increment: u16,
    pub(super) limits: PdoLimits,
    pub(super) fmmu_usage: &'static [u8],
    /// SII categories that nothing here interprets: number and content.
    pub(super) other_categories: &'static [(u16, &'static [u8])],
    pub(super) status_object: Option<AxisStatusObject>,
    pub(super) note: Option<(u16, usize)>,
    /// 1010h and 1011h are there.
    pub(super) saves: bool,
    /// SAFEOP is refused when sync manager and process-data watchdog do not agree.
    pub(super) checks_watchdog: bool,
    pub(super) emulates_eeprom: bool,
}

/// A servo drive of which details can be changed before it is built. Start from the drive that is meant.
///
/// ```
/// use servocrab_sim::personality::Servo;
/// let drive = Servo::akd2g().serial(4711).inputs_at(0x1140).build();
/// assert_eq!(drive.axes().len(), 2);
/// let drive = Servo::sigma7().change(|behaviour| behaviour.power_on_cycles = 5).build();
/// assert_eq!(drive.axes().len(), 1);
/// ```
#[derive(Clone, Debug)]
pub struct Servo {
    pub(super) model: Model,
    behaviours: Vec<Behaviour>,
    supports_lrw: bool,
    takes_shorter_mailboxes: bool,
    clock: Option<ClockWidth>,
    clock_demand: Option<ClockDemand>,
    sm_synchronous: bool,
    alias: u16,
    objects: Vec<PlainObject>,
    diagnosis: Option<u8>,
    pub(super) pdos: super::servo_pdos::Changes,
}

impl Servo {
    pub(super) fn new(model: Model) -> Self {
        let servo = Self {
            behaviours: vec![(model.behaviour)(); model.axes],
            model,
            supports_lrw: true,
            takes_shorter_mailboxes: false,
            clock: Some(ClockWidth::Bits64),
            clock_demand: None,
            sm_synchronous: false,
            alias: 0,
            objects: Vec::new(),
            diagnosis: None,
            pdos: super::servo_pdos::Changes::default(),
        };
        servo.plant(Plant::default())
    }

    /// Hangs a plant on every axis; each has a seed of its own, one more than the axis before.
    ///
    /// ```
    /// use servocrab_sim::{ds402::Plant, personality::Servo};
    ///
    /// let drive = Servo::akd2g().plant(Plant::ideal()).build();
    /// assert_eq!(drive.axis(1).map(|axis| axis.plant().dither), Some(0));
    /// ```
    #[must_use]
    pub fn plant(mut self, plant: Plant) -> Self {
        for (number, behaviour) in (0..).zip(&mut self.behaviours) {
            behaviour.plant = plant.with_seed(plant.seed.wrapping_add(number));
        }
        self
    }

    /// Gives the drive a serial number.
    #[must_use]
    pub fn serial(mut self, serial: u32) -> Self {
        self.model.identity.serial = serial;
        self
    }

    /// Gives the drive a configured station alias (word 4 of the SII).
    #[must_use]
    pub fn alias(mut self, alias: u16) -> Self {
        self.alias = alias;
        self
    }

    /// Gives the drive another identity.
    #[must_use]
    pub fn identity(mut self, identity: Identity) -> Self {
        self.model.identity = identity;
        self
    }

    /// Changes how all axes behave.
    #[must_use]
    pub fn behaviour(mut self, behaviour: Behaviour) -> Self {
        self.behaviours = vec![behaviour; self.behaviours.len()];
        self
    }

    /// Changes how one axis, counted from 0, behaves.
    #[must_use]
    pub fn axis_behaviour(mut self, axis: usize, behaviour: Behaviour) -> Self {
        if let Some(known) = self.behaviours.get_mut(axis) {
            *known = behaviour;
        }
        self
    }

    /// Changes something in how all axes behave.
    #[must_use]
    pub fn change(mut self, change: impl Fn(&mut Behaviour)) -> Self {
        self.behaviours.iter_mut().for_each(change);
        self
    }

    /// Adds an object of the maker's.
    #[must_use]
    pub fn object(mut self, object: PlainObject) -> Self {
        self.objects.push(object);
        self
    }

    /// Gives the drive a diagnosis history (10F3h) with room for so many messages. No document of the drives here names one.
    #[must_use]
    pub fn diagnosis_history(mut self, messages: u8) -> Self {
        self.diagnosis = Some(messages);
        self
    }

    /// Gives every axis an absolute encoder: it is referenced from the start, without homing.
    #[must_use]
    pub fn absolute_encoder(self) -> Self {
        self.change(|behaviour| behaviour.machine.absolute_encoder = true)
    }

    /// Makes every axis a modulo axis with these first and last positions (607Bh at power-up).
    #[must_use]
    pub fn modulo(self, first: i32, last: i32) -> Self {
        self.change(|behaviour| behaviour.position_range = (first, last))
    }

    /// Sets the address that the SII gives for the inputs.
    #[must_use]
    pub fn inputs_at(mut self, address: u16) -> Self {
        self.model.inputs.start = address;
        self
    }

    /// Sets the size of both mailboxes, up to the drive's own.
    #[must_use]
    pub fn mailbox_bytes(mut self, bytes: u16) -> Self {
        self.model.mailbox.2 = bytes.min(self.model.mailbox.2);
        self
    }

    /// Puts both mailboxes elsewhere in its memory, each with this length. It takes shorter ones as well.
    #[must_use]
    pub fn mailboxes_at(mut self, out: u16, input: u16, bytes: u16) -> Self {
        self.model.mailbox = (out, input, bytes);
        self.takes_shorter_mailboxes = true;
        self
    }

    /// Adds the SDO information service.
    #[must_use]
    pub fn with_sdo_information(mut self) -> Self {
        self.model.coe_details |= Mailbox::SDO_INFORMATION;
        self
    }

    /// Takes the SDO information service away.
    #[must_use]
    pub fn without_sdo_information(mut self) -> Self {
        self.model.coe_details &= !Mailbox::SDO_INFORMATION;
        self
    }

    /// Adds complete access.
    #[must_use]
    pub fn with_complete_access(mut self) -> Self {
        self.model.coe_details |= Mailbox::COMPLETE_ACCESS;
        self
    }

    /// Takes complete access away.
    #[must_use]
    pub fn without_complete_access(mut self) -> Self {
        self.model.coe_details &= !Mailbox::COMPLETE_ACCESS;
        self
    }

    /// Lets it be synchronised with its process data as well: 1C32h:1 takes 1, 1C33h:1 takes 34.
    #[must_use]
    pub fn sm_synchronous(mut self) -> Self {
        self.sm_synchronous = true;
        self
    }

    /// Takes the LRW command away, so that the MainDevice needs LRD and LWR.
    #[must_use]
    pub fn without_lrw(mut self) -> Self {
        self.supports_lrw = false;
        self
    }

    /// Gives the drive a distributed clock of this width, or none.
    #[must_use]
    pub fn clock(mut self, clock: Option<ClockWidth>) -> Self {
        self.clock = clock;
        self
    }

    /// Makes the drive insist on its distributed clock.
    #[must_use]
    pub fn insists_on_clock(mut self, demand: ClockDemand) -> Self {
        self.clock_demand = Some(demand);
        self
    }

    /// The drive, just switched on.
    #[must_use]
    pub fn build(self) -> Device {
        let cycle = self
            .behaviours
            .first()
            .map_or(core::time::Duration::from_millis(1), |behaviour| {
                behaviour.period
            });
        Device::new(Blueprint {
            description: self.description(),
            drive: Some(self.drive()),
            cycle,
        })
    }

    fn description(&self) -> Description {
        let model = &self.model;
        let mut description = Description::new(model.name, model.identity);
        description.alias = self.alias;
        description.order = model.order.to_owned();
        description.group = "Drives".to_owned();
        let (out, input, length) = model.mailbox;
        description.mailbox = Some(Mailbox {
            out: (out, length),
            input: (input, length),
            protocols: model.protocols,
            coe_details: model.coe_details,
        });
        description.pdos = self.pdos(model.rx_pdos, Direction::Outputs);
        description
            .pdos
            .extend(self.pdos(model.tx_pdos, Direction::Inputs));
        self.pdos.apply(&mut description.pdos);
        let bytes =
            |direction| u16::try_from(description.process_data_bytes(direction)).unwrap_or(0);
        let sync_manager = |start, length, control, purpose| SyncManagerDescription {
            start,
            length,
            control,
            purpose,
        };
        let (outputs, inputs) = (bytes(Direction::Outputs), bytes(Direction::Inputs));
        description.sync_managers = vec![
            sync_manager(out, length, 0x26, SyncManagerUse::MailboxOut),
            sync_manager(input, length, 0x22, SyncManagerUse::MailboxIn),
            sync_manager(
                model.outputs.start,
                outputs,
                model.outputs.control,
                SyncManagerUse::Outputs,
            ),
            sync_manager(
                model.inputs.start,
                inputs,
                model.inputs.control,
                SyncManagerUse::Inputs,
            ),
        ];
        description.fmmu_usage = model.fmmu_usage.to_vec();
        let clock_mode = |name: &str, assign_activate| ClockMode {
            name: name.to_owned(),
            assign_activate,
        };
        if self.clock.is_some() {
            description.clock_modes = vec![clock_mode("DcSync", 0x0300), clock_mode("DcOff", 0)];
        }
        description.other_categories = model
            .other_categories
            .iter()
            .map(|(kind, content)| (*kind, content.to_vec()))
            .collect();
        description.ds402_channels = u8::try_from(self.behaviours.len()).unwrap_or(u8::MAX);
        description.checks_watchdog = model.checks_watchdog;
        description.emulates_eeprom = model.emulates_eeprom;
        description.supports_lrw = self.supports_lrw;
        description.takes_shorter_mailboxes = self.takes_shorter_mailboxes;
        description.clock = self.clock;
        description.clock_demand = self.clock_demand;
        description.sm_synchronous = self.sm_synchronous;
        description
    }

    /// The PDOs of all axes in one direction.
    fn pdos(&self, of_one_axis: &[Pdo], direction: Direction) -> Vec<PdoDescription> {
        let sync_manager = match direction {
            Direction::Outputs => 2,
            Direction::Inputs => 3,
        };
        let mut pdos = Vec::new();
        for (number, behaviour) in (0..).zip(&self.behaviours) {
            let axis = Axis::new(behaviour.clone());
            pdos.extend(of_one_axis.iter().map(|pdo| {
                PdoDescription {
                    index: pdo.index + number * self.model.pdo_increment,
                    name: "",
                    direction,
                    sync_manager: pdo.assigned.then_some(sync_manager),
                    fixed: false,
                    mandatory: false,
                    excludes: Vec::new(),
                    entries: pdo
                        .objects
                        .iter()
                        .filter_map(|index| entry(&axis, *index, number * AXIS_INCREMENT))
                        .collect(),
                }
            }));
        }
        pdos
    }

    fn drive(self) -> DriveBlueprint {
        DriveBlueprint {
            axes: self.behaviours,
            axis_increment: AXIS_INCREMENT,
            device_type: self.model.device_type,
            status_object: self.model.status_object,
            note: self.model.note,
            limits: self.model.limits,
            assigned: self.pdos.assigned,
            pdo_habits: self.pdos.habits,
            objects: self.objects,
            shows_only_these: false,
            diagnosis: self.diagnosis,
            saves: self.model.saves,
            software_version: "simulated".to_owned(),
            hardware_version: "simulated".to_owned(),
        }
    }
}

/// An object of an axis as a PDO of the SII names it.
fn entry(axis: &Axis, index: u16, offset: u16) -> Option<PdoEntryDescription> {
    let entry = axis
        .entries()
        .iter()
        .find(|entry| (entry.index, entry.subindex) == (index, 0))?;
    // Data types as the SII codes them (ETG.1000.6, basic data types).
    let data_type = match entry.kind {
        DataType::I8 => 2,
        DataType::I16 => 3,
        DataType::I32 => 4,
        DataType::U8 => 5,
        DataType::U16 => 6,
        DataType::U32 => 7,
    };
    Some(PdoEntryDescription {
        index: index + offset,
        subindex: 0,
        name: "",
        data_type,
        bits: 8 * entry.kind.size() as u8,
    })
}
