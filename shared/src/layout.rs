//! Plain data with a layout that both ends can check.
//!
//! iceoryx2 compares size, alignment and type name of what two processes exchange; two builds with swapped fields
//! would pass that. So the type name of every sample carries a hash over names, types and order of its fields,
//! computed at compile time from the definition itself: it cannot be forgotten.

#![expect(unsafe_code, reason = "the trait promises what the compiler can't check; each SAFETY note says why")]

use crate::sample::{Message, Origin};

/// Plain data: every bit pattern valid, no padding, no pointers. Implemented by [`wire!`](crate::wire) and here for
/// the primitives.
///
/// # Safety
/// The type is `#[repr(C)]` without padding, and any bit pattern is a valid value.
pub unsafe trait Layout: Copy + 'static {
    /// Hash over the names and types of all fields, recursively.
    const HASH: u64;
}

/// The bytes of a sample, as a recording keeps them.
#[must_use]
pub fn bytes_of<T: Layout>(value: &T) -> &[u8] {
    // SAFETY: plain data without padding: all its bytes are initialised, and they live as long as the value.
    unsafe { core::slice::from_raw_parts(core::ptr::from_ref(value).cast(), size_of::<T>()) }
}

/// The sample of such bytes; none if their number is another one. Whether they are of this layout is for the caller to
/// know, by [`Layout::HASH`].
#[must_use]
pub fn from_bytes<T: Layout>(bytes: &[u8]) -> Option<T> {
    // SAFETY: as many bytes as the type has (checked here), of which any pattern is a value; read without alignment.
    (bytes.len() == size_of::<T>()).then(|| unsafe { bytes.as_ptr().cast::<T>().read_unaligned() })
}

/// What a recording keeps of a message: all its bytes but those of its origin, which identifies and is no result.
#[must_use]
pub fn content_of<T: Message>(message: &T) -> &[u8] {
    &bytes_of(message)[size_of::<Origin>()..]
}

/// The message of such bytes, with no origin; none if their number is another one. Whether they are of this layout is for
/// the caller to know, by [`Message::CONTENT_HASH`].
#[must_use]
pub fn from_content<T: Message>(content: &[u8]) -> Option<T> {
    from_bytes(&[bytes_of(&Origin::zeroed()), content].concat())
}

/// FNV-1a over `text`, continued from `hash`.
#[must_use]
pub const fn fnv1a(mut hash: u64, text: &[u8]) -> u64 {
    let mut i = 0;
    while i < text.len() {
        hash = (hash ^ text[i] as u64).wrapping_mul(0x0000_0100_0000_01b3);
        i += 1;
    }
    hash
}

/// The start value of [`fnv1a`].
pub const FNV_START: u64 = 0xcbf2_9ce4_8422_2325;

macro_rules! primitives {
    ($($t:ty),*) => {$(
        // SAFETY: a number has no padding and every bit pattern is a value.
        unsafe impl Layout for $t {
            const HASH: u64 = fnv1a(FNV_START, stringify!($t).as_bytes());
        }
    )*};
}
primitives!(u8, u32, u64, i64, f64);

// SAFETY: an array of plain data is plain data without padding between its entries.
unsafe impl<T: Layout, const K: usize> Layout for [T; K] {
    const HASH: u64 = fnv1a(T::HASH, &(K as u64).to_le_bytes());
}

/// `loopbound.NAME.<16 hex digits>` as bytes, of which the first `length` count.
#[must_use]
pub const fn type_name_bytes(name: &str, hash: u64) -> ([u8; 64], usize) {
    let (prefix, name) = (b"loopbound.", name.as_bytes());
    let mut out = [0; 64];
    let mut at = 0;
    let mut i = 0;
    while i < prefix.len() {
        out[at] = prefix[i];
        at += 1;
        i += 1;
    }
    i = 0;
    while i < name.len() {
        out[at] = name[i];
        at += 1;
        i += 1;
    }
    out[at] = b'.';
    at += 1;
    i = 0;
    while i < 16 {
        out[at] = b"0123456789abcdef"[((hash >> (60 - 4 * i)) & 15) as usize];
        at += 1;
        i += 1;
    }
    (out, at)
}

/// Defines plain data for shared memory: `#[repr(C)]`, Copy, no padding (checked at compile time), a layout hash, and
/// a type name that carries it. All-zero bytes are a valid value, given by `zeroed()`.
#[macro_export]
macro_rules! wire {
    ($(#[$meta:meta])* pub struct $name:ident { $($(#[$field_meta:meta])* pub $field:ident : $t:ty,)* }) => {
        $(#[$meta])*
        #[repr(C)]
        #[derive(Clone, Copy, Debug, PartialEq)]
        pub struct $name { $($(#[$field_meta])* pub $field: $t,)* }

        const _: () = assert!(
            size_of::<$name>() == 0 $(+ size_of::<$t>())*,
            concat!(stringify!($name), " has padding: reorder its fields")
        );

        // SAFETY: repr(C), no padding (asserted above), and every field is plain data itself.
        #[expect(unsafe_code, reason = "plain data for shared memory, checked by the assertion above")]
        unsafe impl $crate::layout::Layout for $name {
            const HASH: u64 = $crate::hash_of_fields!($name { $($field: $t,)* });
        }

        // SAFETY: plain data (see above); the name changes whenever a field does, so two ends that agree on the name
        // agree on the layout.
        #[expect(unsafe_code, reason = "the derive takes a literal type name only, and cannot carry a computed hash")]
        unsafe impl iceoryx2::prelude::ZeroCopySend for $name {
            unsafe fn type_name() -> &'static str {
                const NAME: ([u8; 64], usize) =
                    $crate::layout::type_name_bytes(stringify!($name), <$name as $crate::layout::Layout>::HASH);
                const TEXT: &str = match core::str::from_utf8(NAME.0.split_at(NAME.1).0) {
                    Ok(text) => text,
                    Err(_) => panic!("ASCII only"),
                };
                TEXT
            }
        }

        impl $name {
            /// The value whose every field is zero.
            #[must_use]
            pub const fn zeroed() -> Self {
                // SAFETY: all fields are plain numbers (checked by Layout), for which zero bytes are a value.
                #[expect(unsafe_code, reason = "zero bytes are a value of plain data")]
                unsafe { core::mem::zeroed() }
            }
        }
    };
}

/// Hash over a type's name and the names and types of its fields.
#[doc(hidden)]
#[macro_export]
macro_rules! hash_of_fields {
    ($name:ident { $($field:ident : $t:ty,)* }) => {{
        let hash = $crate::layout::fnv1a($crate::layout::FNV_START, stringify!($name).as_bytes());
        $(
            let hash = $crate::layout::fnv1a(hash, stringify!($field).as_bytes());
            let hash = $crate::layout::fnv1a(hash, &<$t as $crate::layout::Layout>::HASH.to_le_bytes());
        )*
        hash
    }};
}

/// Defines a [`Message`](crate::sample::Message): [`wire!`](crate::wire) data that begins with its origin. After its name
/// come its kind, and the role and number that its writer has by what it says.
#[macro_export]
macro_rules! message {
    ($(#[$meta:meta])* pub struct $name:ident : $kind:ident, |$by:pat_param| $role:expr, |$of:pat_param| $writer:expr; {
        $($(#[$field_meta:meta])* pub $field:ident : $t:ty,)*
    }) => {
        $crate::wire! {
            $(#[$meta])*
            pub struct $name {
                /// Whose it is: stamped by the port that sends it.
                pub origin: $crate::sample::Origin,
                $($(#[$field_meta])* pub $field: $t,)*
            }
        }

        const _: () = assert!(core::mem::offset_of!($name, origin) == 0, "a message begins with its origin");

        impl $crate::sample::Message for $name {
            const KIND: $crate::event::MessageKind = $crate::event::MessageKind::$kind;
            const CONTENT_HASH: u64 = $crate::hash_of_fields!($name { $($field: $t,)* });

            fn origin(&self) -> &$crate::sample::Origin {
                &self.origin
            }

            fn origin_mut(&mut self) -> &mut $crate::sample::Origin {
                &mut self.origin
            }

            fn role(&self) -> Option<$crate::event::Role> {
                let $by = self;
                $role
            }

            fn writer(&self) -> Option<u32> {
                let $of = self;
                $writer
            }
        }
    };
}

/// Layout hash of plain data that is defined with its own module; the list of fields is checked to be whole.
macro_rules! layout_of {
    ($name:path { $($field:ident : $t:ty),* $(,)? }) => {
        const _: () = assert!(size_of::<$name>() == 0 $(+ size_of::<$t>())*, "padding, or a field is not listed");
        const _: fn($name) = |value| { let $name { $($field),* } = value; $(let _: $t = $field;)* };
        // SAFETY: no padding (asserted), every field listed (destructured above) and plain data itself.
        unsafe impl Layout for $name {
            const HASH: u64 = {
                let hash = fnv1a(FNV_START, stringify!($name).as_bytes());
                $(
                    let hash = fnv1a(hash, stringify!($field).as_bytes());
                    let hash = fnv1a(hash, &<$t as Layout>::HASH.to_le_bytes());
                )*
                hash
            };
        }
    };
}
use crate::realtime::{Evidence, Privileges, STEPS};
layout_of!(Evidence {
    run_delay_ns: u64,
    timeslices: u64,
    run_time_ns: u64,
    voluntary_switches: u64,
    involuntary_switches: u64,
    minor_faults: u64,
    major_faults: u64,
    missing: u64,
});
layout_of!(Privileges { priority: u32, core: u32, steps: [u32; STEPS.len()] });

#[cfg(test)]
mod tests {
    use super::Layout;

    #[expect(unreachable_pub, dead_code, reason = "the macro makes public types")]
    mod a {
        wire! { pub struct Pair { pub x: f64, pub y: f64, } }
    }
    #[expect(unreachable_pub, dead_code, reason = "the macro makes public types")]
    mod b {
        wire! { pub struct Pair { pub y: f64, pub x: f64, } }
    }

    #[test]
    fn a_sample_is_what_its_bytes_say_and_other_numbers_of_bytes_are_none() {
        let mut record = crate::sample::TickRecord::zeroed();
        (record.tick, record.q[3]) = (7, -0.0);
        let bytes = super::bytes_of(&record).to_vec();
        let back: crate::sample::TickRecord = super::from_bytes(&bytes).unwrap();
        assert_eq!((back.tick, back.q[3].to_bits()), (7, (-0.0f64).to_bits()));
        assert!(super::from_bytes::<crate::sample::TickRecord>(&bytes[1..]).is_none());
    }

    #[test]
    fn swapped_fields_of_one_size_have_another_type_name() {
        use iceoryx2::prelude::ZeroCopySend;
        assert_ne!(a::Pair::HASH, b::Pair::HASH);
        #[expect(unsafe_code, reason = "the trait's function is unsafe to implement wrongly, not to call")]
        // SAFETY: only reads a constant.
        let (a, b) = unsafe { (a::Pair::type_name(), b::Pair::type_name()) };
        assert!(a.starts_with("loopbound.Pair.") && a.len() == b.len());
        assert_ne!(a, b);
    }
}
