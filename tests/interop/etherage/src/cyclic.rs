//! The checks with process data: from SAFEOP to OP and a whole move.

use std::cell::Cell;
use std::time::Duration;

use etherage::{
    CommunicationState, Sdo, Slave,
    mapping::{Group, Mapping},
    registers::{self, AlError},
    sdo,
};
use tokio::{sync::Notify, time};

use crate::{
    Outcome,
    acyclic::{Memory, object, read, write},
    drive::{Drive, Field},
    expect, in_time, ok,
};

const PERIOD: Duration = Duration::from_millis(1);
/// Exchanges of the cyclic check.
const EXCHANGES: usize = 500;

/// What an encoder shows at rest goes up and down by less than this.
const NOISE: i64 = 5;

/// Where in the group's buffers the fields are, by their index.
pub type Places = Vec<(u16, usize)>;

/// Pushes the drive's mapping; what comes back says where the fields are.
pub fn place(mapping: &Mapping<'_>, drive: &Drive, memory: &Memory) -> Places {
    let mut places = Places::new();
    let mut slave = mapping.slave(crate::ADDRESS);
    for outputs in [true, false] {
        let mut channel = if outputs {
            slave.channel(sdo::sync_manager.logical_write(), memory.outputs.clone())
        } else {
            slave.channel(sdo::sync_manager.logical_read(), memory.inputs.clone())
        };
        for axis in &drive.axes {
            let (pdo, fields) = if outputs {
                (axis.rx, &axis.outputs)
            } else {
                (axis.tx, &axis.inputs)
            };
            let mut pdo = channel.push(sdo::Pdo::new(pdo, false));
            for field in fields.iter().filter(|field| field.mapped) {
                let place = pdo.push(Sdo::<()>::sub_with_size(field.index, 0, 0, 8 * field.bytes));
                places.push((field.index, place.byte));
            }
        }
    }
    places
}

/// The drive's process data, and the cycles that carry it.
pub struct Bench<'b, 'a> {
    group: &'b Group<'a>,
    drive: &'b Drive,
    places: Places,
    cycle: Notify,
    exchanges: Cell<usize>,
    /// No process data goes out.
    paused: Cell<bool>,
}

impl<'b, 'a> Bench<'b, 'a> {
    pub fn new(group: &'b Group<'a>, drive: &'b Drive, places: Places) -> Self {
        Self {
            group,
            drive,
            places,
            cycle: Notify::new(),
            exchanges: Cell::new(0),
            paused: Cell::new(false),
        }
    }

    /// Exchanges process data for ever.
    pub async fn exchange(&self) {
        let mut period = time::interval(PERIOD);
        loop {
            if !self.paused.get() {
                self.group.data().await.exchange().await;
                self.exchanges.set(self.exchanges.get() + 1);
                self.cycle.notify_waiters();
            }
            period.tick().await;
        }
    }

    pub async fn checks(&self, slave: &mut Slave<'_>) -> Outcome {
        self.operational(slave).await?;
        self.cyclic(slave).await?;
        self.enable(slave).await?;
        self.profile_move(slave).await?;
        self.watchdog(slave).await?;
        self.recovery(slave).await?;
        self.fault_reset(slave).await
    }

    fn place(&self, field: Field) -> usize {
        let known = self.places.iter().find(|(index, _)| *index == field.index);
        known.expect("it is mapped").1
    }

    fn fields(&self, index: u16) -> Vec<Field> {
        let axes = self.drive.axes.iter();
        axes.map(|axis| {
            let mut fields = axis.outputs.iter().chain(&axis.inputs);
            let known = fields.find(|field| field.index == index + axis.offset);
            *known.expect("the table has it")
        })
        .collect()
    }

    /// An input of all axes, as it came last.
    async fn get(&self, index: u16) -> Vec<i64> {
        let mut group = self.group.data().await;
        let data = group.read_buffer();
        let fields = self.fields(index).into_iter();
        fields
            .map(|field| field.unpack(&data[self.place(field)..]))
            .collect()
    }

    /// An output of all axes, from the next exchange on; by SDO where it is not mapped.
    async fn set(&self, slave: &Slave<'_>, index: u16, values: &[i64]) -> Outcome {
        for (field, value) in self.fields(index).into_iter().zip(values) {
            let bytes = field.pack(*value);
            if field.mapped {
                let mut group = self.group.data().await;
                let at = self.place(field);
                group.write_buffer()[at..at + field.bytes].copy_from_slice(&bytes);
            } else {
                write(slave, object(field.index, 0, field.bytes), &bytes).await?;
            }
        }
        Ok(())
    }

    /// The same for all axes.
    async fn set_all(&self, slave: &Slave<'_>, index: u16, value: i64) -> Outcome {
        self.set(slave, index, &vec![value; self.drive.axes.len()])
            .await
    }

    /// Cycles until an input of all axes is so; what the inputs are then.
    async fn until(
        &self,
        what: &str,
        index: u16,
        is: impl Fn(usize, i64) -> bool,
    ) -> Outcome<Vec<i64>> {
        in_time(what, async {
            loop {
                self.cycle.notified().await;
                let values = self.get(index).await;
                if values
                    .iter()
                    .enumerate()
                    .all(|(axis, value)| is(axis, *value))
                {
                    return Outcome::Ok(values);
                }
            }
        })
        .await
    }

    async fn until_status(&self, what: &str, mask: i64, wanted: i64) -> Outcome {
        self.until(what, 0x6041, |_, word| word & mask == wanted)
            .await
            .map(|_| ())
    }

    async fn operational(&self, slave: &mut Slave<'_>) -> Outcome {
        // Inputs have come when the statusword is no longer the zero of the empty buffer.
        self.until("inputs", 0x6041, |_, word| word != 0).await?;
        let here = self.get(0x6064).await;
        self.set(slave, 0x607A, &here).await?;
        self.set_all(slave, 0x6060, 1).await?;
        self.set_all(slave, 0x6040, 0).await?;
        in_time("OP", slave.switch(CommunicationState::Operational)).await?;
        ok("operational", "OP");
        Ok(())
    }

    /// Outputs arrive while exchanges go on: what is set is what an SDO beside them reads.
    async fn cyclic(&self, slave: &Slave<'_>) -> Outcome {
        let start = self.exchanges.get();
        let here = self.get(0x6064).await;
        let targets = self.fields(0x607A);
        let mut round = 0;
        while self.exchanges.get() < start + EXCHANGES {
            round += 1;
            let wanted: Vec<i64> = here.iter().map(|position| position + round).collect();
            self.set(slave, 0x607A, &wanted).await?;
            for (field, wanted) in targets.iter().zip(wanted) {
                let arrived = async {
                    let object = object(field.index, 0, field.bytes);
                    while field.unpack(&read(slave, object).await?) != wanted {}
                    Outcome::Ok(())
                };
                in_time("an output arrives", arrived).await?;
            }
        }
        self.set(slave, 0x607A, &here).await?;
        let state = slave.state().await?;
        expect("the state", state, CommunicationState::Operational)?;
        ok(
            "cyclic",
            format_args!("{EXCHANGES} exchanges and more, outputs read back beside them"),
        );
        Ok(())
    }

    async fn enable(&self, slave: &Slave<'_>) -> Outcome {
        for (name, word, mask, wanted) in [
            ("Switch on disabled", 0x0000, 0x004F, 0x0040),
            ("Ready to switch on", 0x0006, 0x006F, 0x0021),
            ("Switched on", 0x0007, 0x006F, 0x0023),
            ("Operation enabled", 0x000F, 0x006F, 0x0027),
        ] {
            self.set_all(slave, 0x6040, word).await?;
            self.until_status(name, mask, wanted).await?;
        }
        self.until("mode 1", 0x6061, |_, mode| mode == 1).await?;
        ok("enable", "Operation enabled, mode 1");
        Ok(())
    }

    /// Absolute moves of all axes to targets of their own, judged by bits 12 and 10 and the position.
    async fn profile_move(&self, slave: &Slave<'_>) -> Outcome {
        let here = self.get(0x6064).await;
        let targets: Vec<i64> = (0..)
            .zip(&here)
            .map(|(axis, at)| at + 40_000 + 1_000 * axis)
            .collect();
        self.set(slave, 0x607A, &targets).await?;
        for (index, value) in [(0x6081, 100_000), (0x6083, 2_000_000), (0x6084, 2_000_000)] {
            self.set_all(slave, index, value).await?;
        }
        self.until_status("bit 12 low before", 0x1000, 0).await?;
        self.set_all(slave, 0x6040, 0x1F).await?;
        self.until_status("bit 12 high", 0x1000, 0x1000).await?;
        self.set_all(slave, 0x6040, 0x0F).await?;
        self.until_status("bit 12 low after", 0x1000, 0).await?;
        self.until_status("bit 10 low on the way", 0x0400, 0)
            .await?;
        self.until("on the way", 0x6064, |axis, at| {
            here[axis] < at && at < targets[axis]
        })
        .await?;
        self.until_status("bit 10 at arrival", 0x0400, 0x0400)
            .await?;
        let near = |axis: usize, at: i64| (at - targets[axis]).abs() <= self.drive.window + NOISE;
        let there = self.get(0x6064).await;
        for (axis, at) in there.iter().enumerate() {
            expect(
                &format!("{at} is the target {}", targets[axis]),
                near(axis, *at),
                true,
            )?;
        }
        ok("profile_move", format_args!("at {there:?}"));
        Ok(())
    }

    /// Outputs stop in mid move: SAFEOP with 001Bh.
    async fn watchdog(&self, slave: &Slave<'_>) -> Outcome {
        let here = self.get(0x6064).await;
        let far: Vec<i64> = here.iter().map(|at| at + 1_000_000).collect();
        self.set(slave, 0x607A, &far).await?;
        self.set_all(slave, 0x6040, 0x1F).await?;
        self.until_status("bit 12 high", 0x1000, 0x1000).await?;
        self.set_all(slave, 0x6040, 0x0F).await?;
        self.until("moving", 0x6064, |axis, at| at > here[axis] + 1_000)
            .await?;
        self.paused.set(true);
        in_time("the error", async {
            while !slave.physical_read(registers::al::response).await?.error() {}
            Outcome::Ok(())
        })
        .await?;
        let state = slave.state().await?;
        expect("the state", state, CommunicationState::SafeOperational)?;
        let code = slave.physical_read(registers::al::error).await?;
        expect("the AL status code", code, AlError::SyncWatchdog)?;
        ok("watchdog", "AL status code 001Bh");
        Ok(())
    }

    /// Acknowledged, then OP again; the axes have faulted and stay where they are. No SDO any more: the emergencies of
    /// the fault wait in the mailbox.
    async fn recovery(&self, slave: &mut Slave<'_>) -> Outcome {
        in_time("SAFEOP", slave.switch(CommunicationState::SafeOperational)).await?;
        self.set_all(slave, 0x6040, 0).await?;
        self.paused.set(false);
        in_time("OP", slave.switch(CommunicationState::Operational)).await?;
        self.until_status("Fault", 0x004F, 0x0008).await?;
        let before = self.get(0x6064).await;
        for _ in 0..50 {
            self.cycle.notified().await;
        }
        // What an encoder shows goes up and down at rest.
        for (at, before) in self.get(0x6064).await.into_iter().zip(before) {
            let stayed = (at - before).abs() <= NOISE;
            expect(&format!("{at} is where it was, {before}"), stayed, true)?;
        }
        ok("recovery", "OP again, axes in Fault, at rest");
        Ok(())
    }

    async fn fault_reset(&self, slave: &Slave<'_>) -> Outcome {
        self.set_all(slave, 0x6040, 0x80).await?;
        self.until_status("Switch on disabled", 0x004F, 0x0040)
            .await?;
        ok("fault_reset", "Switch on disabled");
        Ok(())
    }
}
