//! Floor 0: which vector instructions the machine has, and functions that are compiled once for each.
//!
//! One binary runs on any processor of its architecture. A hot function is written once, in plain Rust over slices, as
//! the body of the macro `on_each_path!`; the compiler makes one copy of it for each [`Path`] and the copy is chosen at
//! run time. Rust contracts no floating-point operations by itself, so every copy computes the same numbers bit by bit.

mod step;

pub use step::step_rows;

use std::fmt;
use std::sync::atomic::{AtomicU8, Ordering};

/// 1 and the number of the path that [`Path::best`] returns, or 0 for the fastest.
static FORCED: AtomicU8 = AtomicU8::new(0);

/// A set of vector instructions that this machine has.
///
/// A value of this type is the proof that the machine has them: there is no other way to get one than to look.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub struct Path(Kind);

/// The sets for which copies are compiled.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Kind {
    /// What every processor of the architecture has: SSE2 on x86-64, NEON on aarch64.
    Portable,
    /// AVX2 with the bit manipulation that came with it.
    #[cfg(target_arch = "x86_64")]
    Avx2,
    /// AVX-512 with byte and word operations.
    #[cfg(target_arch = "x86_64")]
    Avx512,
}

impl Path {
    /// The path that runs everywhere.
    pub const PORTABLE: Self = Self(Kind::Portable);

    /// The fastest path of this machine, or the one that [`Path::force`] was called with.
    #[must_use]
    pub fn best() -> Self {
        match FORCED.load(Ordering::Relaxed) {
            0 => Self::fastest(),
            number => Self::all().get(usize::from(number) - 1).copied().unwrap_or(Self::PORTABLE),
        }
    }

    /// Makes [`Path::best`] return one path of this machine for the rest of the program: to measure it, and to test it.
    pub fn force(path: Self) {
        let number = Self::all().iter().position(|known| *known == path).map_or(0, |at| at + 1);
        FORCED.store(number as u8, Ordering::Relaxed);
    }

    fn fastest() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            if Self::has_avx512() {
                return Self(Kind::Avx512);
            }
            if Self::has_avx2() {
                return Self(Kind::Avx2);
            }
        }
        Self::PORTABLE
    }

    /// All paths of this machine, slowest first.
    #[must_use]
    pub fn all() -> Vec<Self> {
        let mut paths = vec![Self::PORTABLE];
        #[cfg(target_arch = "x86_64")]
        {
            paths.extend(Self::has_avx2().then_some(Self(Kind::Avx2)));
            paths.extend(Self::has_avx512().then_some(Self(Kind::Avx512)));
        }
        paths
    }

    /// The path of a name, as [`Display`](fmt::Display) writes it, if this machine has it.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::all().into_iter().find(|path| path.to_string() == name)
    }

    /// What it stands for.
    #[doc(hidden)]
    #[must_use]
    pub fn kind(self) -> Kind {
        self.0
    }

    /// Every feature named in `on_each_path!` for this kind must be asked for here.
    #[cfg(target_arch = "x86_64")]
    fn has_avx2() -> bool {
        std::arch::is_x86_feature_detected!("avx2")
            && std::arch::is_x86_feature_detected!("bmi1")
            && std::arch::is_x86_feature_detected!("bmi2")
            && std::arch::is_x86_feature_detected!("lzcnt")
            && std::arch::is_x86_feature_detected!("popcnt")
    }

    /// As [`Path::has_avx2`].
    #[cfg(target_arch = "x86_64")]
    fn has_avx512() -> bool {
        Self::has_avx2()
            && std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512bw")
            && std::arch::is_x86_feature_detected!("avx512dq")
            && std::arch::is_x86_feature_detected!("avx512vl")
    }
}

impl Default for Path {
    fn default() -> Self {
        Self::best()
    }
}

impl fmt::Display for Path {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self.0 {
            Kind::Portable => "portable",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx2 => "avx2",
            #[cfg(target_arch = "x86_64")]
            Kind::Avx512 => "avx512",
        })
    }
}

/// Defines a function that takes a [`Path`] before its own arguments and runs the copy of its body compiled for it.
///
/// What the body calls must be inlined to be compiled with it: mark helpers `#[inline(always)]`.
macro_rules! on_each_path {
    (
        $(#[$meta:meta])*
        $visibility:vis fn $name:ident($($argument:ident: $type:ty),* $(,)?) $(-> $result:ty)? $body:block
    ) => {
        $(#[$meta])*
        #[allow(clippy::too_many_arguments, reason = "a pass is given its slices and constants one by one")]
        $visibility fn $name(path: $crate::vector::Path, $($argument: $type),*) $(-> $result)? {
            #[inline(always)]
            fn portable($($argument: $type),*) $(-> $result)? $body

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt")]
            fn avx2($($argument: $type),*) $(-> $result)? {
                portable($($argument),*)
            }

            #[cfg(target_arch = "x86_64")]
            #[target_feature(enable = "avx2,bmi1,bmi2,lzcnt,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
            fn avx512($($argument: $type),*) $(-> $result)? {
                portable($($argument),*)
            }

            match path.kind() {
                $crate::vector::Kind::Portable => portable($($argument),*),
                // SAFETY: the only thing that the function asks for is that the processor has the features it was compiled
                // for, and a path of this kind exists only where they were found (`Path::has_avx2`).
                #[cfg(target_arch = "x86_64")]
                #[expect(unsafe_code, reason = "a call of code for instructions that were found on this machine")]
                $crate::vector::Kind::Avx2 => unsafe { avx2($($argument),*) },
                // SAFETY: as above (`Path::has_avx512`).
                #[cfg(target_arch = "x86_64")]
                #[expect(unsafe_code, reason = "a call of code for instructions that were found on this machine")]
                $crate::vector::Kind::Avx512 => unsafe { avx512($($argument),*) },
            }
        }
    };
}
pub(crate) use on_each_path;
