//! The checks below SAFEOP: the SII, SDOs, the mapping.

use std::ops::Range;

use bilge::prelude::u2;
use etherage::{
    EthercatError, Master, Sdo, Slave, SlaveAddress,
    can::{CanError, SdoAbortCode},
    eeprom,
    mapping::Group,
    sii::{Category, CategoryType, SyncManager},
};

use crate::{Outcome, drive::Drive, expect, ok};

const PRIORITY: u2 = u2::new(1);

/// What the SII says of the drive's memory.
pub struct Memory {
    /// Bytes of the mailbox that the master writes.
    pub mailbox: usize,
    /// Room of the outputs' three buffers.
    pub outputs: Range<u16>,
    /// Room of the inputs' three buffers.
    pub inputs: Range<u16>,
}

/// Finds the only drive.
pub async fn scan(master: &Master) -> Outcome<Slave<'_>> {
    master.reset_addresses().await;
    master.reset_logical().await;
    expect("the number of SubDevices", master.slaves().await, 1)?;
    let slave = Slave::new(master, SlaveAddress::AutoIncremented(0)).await?;
    ok("scan", "1 SubDevice");
    Ok(slave)
}

/// Identity, strings and sync managers from the SII.
pub async fn sii(slave: &mut Slave<'_>, drive: &Drive) -> Outcome<Memory> {
    slave.init_sii().await?;
    let mut sii = slave.sii().await;
    sii.acquire().await?;
    let identity = [
        sii.read(eeprom::device::vendor).await?,
        sii.read(eeprom::device::product).await?,
        sii.read(eeprom::device::revision).await?,
    ];
    expect("vendor, product, revision", identity, drive.identity)?;
    let strings = sii.strings().await?;
    let general = sii.generals().await?;
    let string = |number: u8| strings.get(usize::from(number) - 1).cloned();
    expect(
        "the order text",
        string(general.order),
        Some(drive.order.clone()),
    )?;
    expect("the name", string(general.name), Some(drive.name.clone()))?;

    let mailbox = sii.read(eeprom::mailbox::standard::write::size).await?;
    let mut starts = Vec::new();
    let mut categories = sii.categories();
    loop {
        let category: Category = categories.unpack().await?;
        if category.ty() == CategoryType::End {
            break;
        }
        let mut content = categories.sub(2 * category.size());
        while category.ty() == CategoryType::SyncManager && content.remain() > 0 {
            let sync_manager: SyncManager = content.unpack().await?;
            starts.push(sync_manager.address());
        }
    }
    sii.release().await?;
    drop(sii);
    expect("the number of sync managers", starts.len(), 4)?;
    // Each has the memory up to the next, or up to the end of the smallest ESC with so much.
    let room = |start: u16| {
        let next = starts.iter().copied().filter(|other| *other > start).min();
        start..next.unwrap_or(0x2000)
    };
    ok(
        "sii",
        format_args!("{} strings, order {:?}", strings.len(), drive.order),
    );
    Ok(Memory {
        mailbox: usize::from(mailbox),
        outputs: room(starts[2]),
        inputs: room(starts[3]),
    })
}

/// An object as etherage addresses one by subindex; what is called complete there goes by complete access.
pub fn object(index: u16, subindex: u8, bytes: usize) -> Sdo {
    Sdo::sub_with_size(index, subindex, 0, 8 * bytes)
}

pub async fn read(slave: &Slave<'_>, object: Sdo) -> Outcome<Vec<u8>> {
    let mut data = vec![0; object.field.len / 8];
    let mut coe = slave.coe().await;
    Ok(coe
        .sdo_read_slice(&object, PRIORITY, &mut data)
        .await?
        .to_vec())
}

pub async fn write(slave: &Slave<'_>, object: Sdo, data: &[u8]) -> Outcome {
    let mut coe = slave.coe().await;
    Ok(coe.sdo_write_slice(&object, PRIORITY, data).await?)
}

/// An object of one, two and four bytes, written, read back, and set back.
pub async fn expedited(slave: &Slave<'_>) -> Outcome {
    for (index, value) in [
        (0x6060, &[1][..]),
        (0x605D, &[1, 0]),
        (0x6081, &[0x45, 0x23, 0x01, 0x00]),
    ] {
        let object = object(index, 0, value.len());
        let before = read(slave, object).await?;
        for written in [value, &before] {
            write(slave, object, written).await?;
            expect("read back", read(slave, object).await?, written.to_vec())?;
        }
    }
    ok("expedited", "6060h 605Dh 6081h");
    Ok(())
}

/// Normal transfers of one mail each way, up to the most that fits.
pub async fn normal(slave: &Slave<'_>, drive: &Drive, mailbox: usize) -> Outcome {
    let (index, longest) = drive.text_object;
    let most = (mailbox - 16).min(longest);
    for length in [5, 6, 7, 8, most - 1, most] {
        let text: Vec<u8> = (0..length).map(|at| (7 * at + length) as u8).collect();
        write(slave, object(index, 0, length), &text).await?;
        expect(
            "read back",
            read(slave, object(index, 0, longest)).await?,
            text,
        )?;
    }
    ok("normal", format_args!("{index:04X}h, up to {most} bytes"));
    Ok(())
}

/// Each refusal has the code of ETG.1000.6.
pub async fn aborts(slave: &Slave<'_>) -> Outcome {
    let mut coe = slave.coe().await;
    let mut buffer = [0; 4];
    for (object, data, code) in [
        (object(0x2FFE, 0, 4), None, SdoAbortCode::InvalidIndex),
        (object(0x1018, 9, 4), None, SdoAbortCode::InvalidSubIndex),
        (
            object(0x6041, 0, 2),
            Some(&[0, 0][..]),
            SdoAbortCode::ReadOnly,
        ),
        (
            object(0x6040, 0, 2),
            Some(&[0, 0, 0, 0]),
            SdoAbortCode::ServiceTooBig,
        ),
        (
            object(0x6081, 0, 4),
            Some(&[0]),
            SdoAbortCode::ServiceTooSmall,
        ),
        (
            object(0x605A, 0, 2),
            Some(&[99, 0]),
            SdoAbortCode::ValueOutOfRange,
        ),
    ] {
        let answer = match data {
            None => coe
                .sdo_read_slice(&object, PRIORITY, &mut buffer)
                .await
                .map(|_| ()),
            Some(data) => coe.sdo_write_slice(&object, PRIORITY, data).await,
        };
        match answer {
            Err(EthercatError::Slave(_, CanError::Sdo(seen))) => {
                expect("the abort code", seen, code)?
            }
            other => return Err(format!("{object}: expected {code:?}, got {other:?}").into()),
        }
    }
    ok("aborts", "6 refusals");
    Ok(())
}

/// The whole of 1018h in one transfer, or the refusal of it.
pub async fn complete_access(slave: &Slave<'_>, drive: &Drive) -> Outcome {
    let mut whole = [0; 18];
    let identity = Sdo::complete_with_size(0x1018, 8 * whole.len());
    let answer = {
        let mut coe = slave.coe().await;
        let read = coe.sdo_read_slice(&identity, PRIORITY, &mut whole).await;
        read.map(|read| read.to_vec())
    };
    if !drive.complete_access {
        return match answer {
            Err(EthercatError::Slave(_, CanError::Sdo(SdoAbortCode::VariableLength))) => {
                ok("complete_access", "not offered, refused with 06010004h");
                Ok(())
            }
            other => Err(format!("expected 06010004h, got {other:?}").into()),
        };
    }
    let mut wanted = vec![4, 0];
    for subindex in 1..=4 {
        wanted.extend(read(slave, object(0x1018, subindex, 4)).await?);
    }
    expect("1018h", answer?, wanted)?;
    ok("complete_access", "1018h in one transfer");
    Ok(())
}

/// Start-up writes, then etherage's own way of writing a mapping, then the mapping read back.
pub async fn mapping(slave: &Slave<'_>, group: &Group<'_>, drive: &Drive) -> Outcome {
    for (index, subindex, value) in &drive.startup {
        write(slave, object(*index, *subindex, value.len()), value).await?;
    }
    // etherage rewrites the PDOs while they are assigned, which drives refuse: they are taken out before.
    for assignment in [0x1C12, 0x1C13] {
        write(slave, object(assignment, 0, 1), &[0]).await?;
    }
    group.configure(slave).await?;
    for axis in &drive.axes {
        for (pdo, fields) in [(axis.rx, &axis.outputs), (axis.tx, &axis.inputs)] {
            let wanted: Vec<u32> = fields
                .iter()
                .filter(|field| field.mapped)
                .map(|field| (u32::from(field.index) << 16) | (8 * field.bytes as u32))
                .collect();
            let mut seen = Vec::new();
            for slot in 1..=read(slave, object(pdo, 0, 1)).await?[0] {
                let entry = read(slave, object(pdo, slot, 4)).await?;
                seen.push(u32::from_le_bytes(entry.as_slice().try_into()?));
            }
            expect("the mapping", seen, wanted)?;
        }
    }
    ok("mapping", format_args!("{} PDOs", 2 * drive.axes.len()));
    Ok(())
}
