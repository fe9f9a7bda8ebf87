//! Small typed indices, so that an element is never taken for a surface.

macro_rules! index {
    ($(#[$doc:meta])* $name:ident) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
        #[repr(transparent)]
        pub struct $name(pub u32);

        impl $name {
            /// No such thing; the largest value of the index.
            pub const NONE: $name = $name(u32::MAX);

            /// The index for use in a slice.
            #[inline]
            pub fn index(self) -> usize {
                self.0 as usize
            }

            /// Whether this names something.
            #[inline]
            pub fn is_some(self) -> bool {
                self.0 != u32::MAX
            }
        }

        impl From<usize> for $name {
            #[inline]
            fn from(index: usize) -> Self {
                debug_assert!(index < u32::MAX as usize);
                $name(index as u32)
            }
        }
    };
}

index!(
    /// An element of a [`Front`](crate::Front): the piece that receives.
    ElementId
);
index!(
    /// A patch of a [`Front`](crate::Front): one side of a flat source shape, cut into elements.
    PatchId
);
index!(
    /// A surface of a [`Scene`](crate::Scene): one primitive of one instance.
    SurfaceId
);
index!(
    /// A finish (material) of a [`Scene`](crate::Scene).
    FinishId
);
index!(
    /// A texture of a [`Scene`](crate::Scene).
    TextureId
);
index!(
    /// A luminaire group of a [`Scene`](crate::Scene), and so a layer of a solution.
    GroupId
);
