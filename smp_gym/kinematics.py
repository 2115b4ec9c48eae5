# STOPGAP: to be replaced by the real room (helper A: just overwrite this file)
import numpy as np
from dataclasses import dataclass
@dataclass(frozen=True)
class SphereSet:
    link: np.ndarray; center: np.ndarray; radius: np.ndarray
    def __len__(self): return len(self.link)
def concatenate(*s): return SphereSet(np.concatenate([x.link for x in s]),np.concatenate([x.center for x in s]),np.concatenate([x.radius for x in s]))
def rpy(r,p,y):
    cr,sr,cp,sp,cy,sy=np.cos(r),np.sin(r),np.cos(p),np.sin(p),np.cos(y),np.sin(y)
    return np.array([[cy*cp,cy*sp*sr-sy*cr,cy*sp*cr+sy*sr],[sy*cp,sy*sp*sr+cy*cr,sy*sp*cr-cy*sr],[-sp,cp*sr,cp*cr]])
def T(xyz,r): 
    M=np.eye(4); M[:3,:3]=rpy(*r); M[:3,3]=xyz; return M
pi=np.pi; h=pi/2
JOINT_ORIGINS=np.array([T((0,0,.15675),(0,pi,0)),T((0,.0016,-.11875),(-h,0,pi)),T((0,-.41,0),(0,pi,0)),T((0,.2073,-.0114),(-h,0,pi)),T((0,0,-.10375),(h,0,pi)),T((0,.10375,0),(-h,0,pi))])
BASE_TRANSFORM=T((0,0,0),(0,0,h)); END_EFFECTOR=T((0,0,-.16),(pi,h,0)); GRASP_CENTER=np.array([.022,0,0])
JOINT_LOWER=np.array([-2*pi,.820304748437,.331612557879,-2*pi,.523598775598,-2*pi]); JOINT_UPPER=np.array([2*pi,5.46288055874,5.9515727493,2*pi,5.75958653158,2*pi])
JOINT_VELOCITY=np.array([.628318530718]*3+[.837758040957]*3)
def link_transforms(q):
    q=np.asarray(q,float); out=[np.broadcast_to(BASE_TRANSFORM,q.shape[:-1]+(4,4))]
    for i in range(6):
        c,s=np.cos(q[...,i]),np.sin(q[...,i]); R=np.zeros(q.shape[:-1]+(4,4)); R[...,0,0]=c;R[...,0,1]=-s;R[...,1,0]=s;R[...,1,1]=c;R[...,2,2]=1;R[...,3,3]=1
        out.append(out[-1]@JOINT_ORIGINS[i]@R)
    return np.stack(out,-3)
def end_effector_pose(q): return link_transforms(q)[...,6,:,:]@END_EFFECTOR
def sphere_centers(q,sp):
    t=link_transforms(q)[...,sp.link,:,:]; return np.einsum('...sij,sj->...si',t[...,:3,:3],sp.center)+t[...,:3,3]
def seg(l,a,b,r,n): return SphereSet(np.full(n,l),np.linspace(a,b,n).astype(float),np.full(n,r,float))
def arm_spheres():
    return concatenate(seg(0,(0,0,.05),(0,0,.12),.06,3),seg(1,(0,0,0),(0,0,-.12),.055,3),seg(2,(0,0,-.0),(0,-.41,-.0),.055,9),seg(3,(0,0,-.01),(0,.2073,-.0114),.045,6),seg(4,(0,0,0),(0,0,-.10),.04,4),seg(5,(0,0,0),(0,.1,0),.04,4),seg(6,(0,0,-.01),(0,0,-.1),.05,3))
def finger_spheres(a): return concatenate(seg(6,(0,.04,-.11),(0,.03,-.2),.02,4),seg(6,(0,-.04,-.11),(0,-.03,-.2),.02,4))
def box_spheres(half,pose):
    P=END_EFFECTOR@pose; pts=np.array([[i,j,k] for i in(-1,1) for j in (-1,1) for k in (-1,1)])*np.asarray(half)/2
    return SphereSet(np.full(8,6),pts@P[:3,:3].T+P[:3,3],np.full(8,np.linalg.norm(np.asarray(half)/2)))
class UnreachableError(ValueError): pass
def inverse_kinematics(position,rotation=None,seed=None):
    q=np.array(seed,float); 
    def err(q):
        P=end_effector_pose(q); e=P[:3,3]-position
        if rotation is None: return e
        R=P[:3,:3]@np.asarray(rotation).T; return np.concatenate([e,.3*np.array([R[2,1]-R[1,2],R[0,2]-R[2,0],R[1,0]-R[0,1]])/2])
    for _ in range(200):
        e=err(q)
        if np.linalg.norm(e)<1e-6: break
        J=np.stack([(err(q+1e-6*np.eye(6)[i])-e)/1e-6 for i in range(6)],1)
        d=-J.T@np.linalg.solve(J@J.T+1e-4*np.eye(len(e)),e); q=q+d*min(1,.3/np.abs(d).max())
        q=np.clip(q,JOINT_LOWER+.05,JOINT_UPPER-.05)
    if np.linalg.norm(err(q))>1e-3: raise UnreachableError(str((position,err(q))))
    return q
LINKS=("j2s6s200_link_base",)+tuple(f"j2s6s200_link_{i}" for i in range(1,7))
def self_collision_pairs(s): return np.array([(i,j) for i in range(len(s)) for j in range(i+1,len(s)) if abs(s.link[i]-s.link[j])>1 and not (s.link[i]>=3 and s.link[j]>=3)],dtype=np.int64).reshape(-1,2)
